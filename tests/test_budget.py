"""The lines and statements of the project are within the limits of pyproject.toml."""

import ast
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
