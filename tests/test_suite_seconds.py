"""A run of the whole suite fails where it takes more processor seconds than its limit in reference units."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
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
