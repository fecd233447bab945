"""Lines and statements of the project, and processor seconds of the suite, are within the limits of pyproject.toml."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

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
