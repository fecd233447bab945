"""Lines, statements, words, and the suite's processor seconds are within the limits of pyproject.toml."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from generate import PAGES as GENERATED

ROOT = Path(__file__).parents[1]
BUDGET = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["sawmill"]["budget"]
PRODUCT = ("worker", "service")


def sources(*folders):
    """The texts of all Python files; documents of the service are links to other folders."""
    paths = {path for folder in folders for path in (ROOT / folder).rglob("*.py")}
    return [path.read_text() for path in sorted(paths) if "documents" not in path.parts]


@pytest.mark.parametrize(
    ("name", "folders"), [("product", PRODUCT), ("tests", ("tests",)), ("benchmarks", ("benchmarks",))]
)
def test_lines_are_within_the_budget(name, folders):
    lines = sum(text.count("\n") for text in sources(*folders))
    assert lines <= BUDGET[name], f"{name}: only an issue raises the limit in pyproject.toml"


def test_statements_are_within_the_budget():
    texts = sources(*PRODUCT, "docs/tools", "examples")
    statements = sum(isinstance(node, ast.stmt) for text in texts for node in ast.walk(ast.parse(text)))
    assert statements <= BUDGET["statements"], "joined lines and moved files are no savings"


def test_pages_have_as_many_words_written_by_hand_as_the_budget_allows():
    pages = {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - {ROOT / "docs" / name for name in GENERATED}
    texts = (page.read_text() for page in pages if "evidence" not in page.parts and ".fi" not in page.suffixes)
    words = sum(len(re.sub(r"<!-- figure .*?<!-- end -->", "", text, flags=re.DOTALL).split()) for text in texts)
    assert words <= BUDGET["words"], "say it once: another page, a docstring or --help may say it already"


SETTINGS = """
[tool.pytest.ini_options]
testpaths = ["."]
addopts = ["-m", "not nightly", "-p", "processor_seconds"]
markers = ["nightly: many"]
[tool.sawmill.budget]
suite_reference_units = {}
"""
TEST = "import processor_seconds\nprocessor_seconds.reference_s = lambda: 1.0\ndef test_one(): pass\n"


@pytest.mark.parametrize(("limit", "arguments", "code"), [(1e9, [], 0), (1e-9, [], 1), (1e-9, ["test_one.py"], 0)])
def test_a_whole_run_above_the_limit_fails(tmp_path, limit, arguments, code):
    (tmp_path / "pyproject.toml").write_text(SETTINGS.format(limit))
    (tmp_path / "test_one.py").write_text(TEST)
    alone = {"PYTHONPATH": f"{ROOT}/tests/support:{ROOT}/benchmarks", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", *arguments]
    environment = {**os.environ, **alone}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout
    assert ("times the reference computation of 1.000 s" in done.stdout) is (not arguments)
