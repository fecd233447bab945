"""The page of public names: what it holds, what it imports, and that no file in the working folder disturbs it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from generate_notebook import pictures
from generate_options import OPTION_TYPES, option_types
from generate_python import option_rows, parameters

import sawmill_calibration
from sawmill_contracts.calibrations import CalibrationOptions, PaperOptions
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_vocabulary.version import VERSION

DOCUMENTS = Path(__file__).parents[2] / "docs"
PYTHON_PAGE = DOCUMENTS / "look-up/python.md"
SLOW_TO_IMPORT = {"numpy", "numba", "scipy", "h5py", "matplotlib", "pydantic", "skimage"}


def run(script: str, folder: Path) -> str:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command, printed = [sys.executable, "-W", "error", "-c", script], {"capture_output": True, "text": True}
    done = subprocess.run(command, cwd=folder, env=environment, timeout=240, check=False, **printed)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_the_package_imports_nothing_slow_and_a_geometry_needs_numpy_alone(tmp_path):
    assert not set(run("import sys, sawmill_calibration; print(*sys.modules)", tmp_path).split()) & SLOW_TO_IMPORT
    script = "import sys, sawmill_calibration as s; s.Theta, s.Scanner, s.FanBeamGeometry, s.Phantom"
    assert set(run(f"{script}; print(*sys.modules)", tmp_path).split()) & SLOW_TO_IMPORT == {"numpy"}


@pytest.mark.slow
def test_nothing_needs_matplotlib_before_a_plot(tmp_path):
    script = "import sys; from sawmill_calibration import *; print(*sys.modules)"
    assert "matplotlib" not in run(script, tmp_path).split()


def test_every_public_name_is_there_and_documented():
    assert dir(sawmill_calibration) == sorted(sawmill_calibration.__all__)
    for name in sawmill_calibration.__all__:
        public = getattr(sawmill_calibration, name)
        assert public.__name__ == name
        assert public.__doc__
    headings = re.findall(r"^### (?:Class )?(\w+)$", PYTHON_PAGE.read_text(), re.MULTILINE)
    assert sorted(headings) == sorted(sawmill_calibration.__all__)


def test_the_pictures_of_the_first_notebook_are_its_outputs():
    kept = {f"pictures/{path.name}": path.read_bytes() for path in (DOCUMENTS / "pictures").glob("notebook-*.png")}
    assert kept == pictures(), "run make docs"


def test_a_parameter_without_a_description_is_found():
    def calibrate(scan: int, seed: int = 1) -> None:
        """Calibrate.

        Parameters
        ----------
        scan : int
            The scan.
        """

    with pytest.raises(LookupError, match="calibrate has no parameter seed"):
        list(parameters(calibrate))


def test_the_options_are_those_of_the_contracts():
    rows = {name: values for name, values, *_ in option_rows(ReconstructionOptions)}
    assert {f"`{name}`" for name in ReconstructionOptions.model_fields} == rows.keys()
    assert rows["`size`"] == "an integer, at least 16, at most 4096"
    assert rows["`method`"].startswith("`fbp`, `tikhonov`")
    named = {row[0] for row in option_rows(CalibrationOptions)}
    assert {f"`paper.{name}`" for name in PaperOptions.model_fields} <= named


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'calibrator'"):
        sawmill_calibration.calibrator  # noqa: B018


@pytest.mark.slow
def test_the_page_s_example_runs_beside_files_named_as_our_folders(tmp_path):
    for name in ("worker.py", "service.py"):
        (tmp_path / name).write_text("raise SystemExit('a file of the user was imported')")
    (example,) = re.findall(r"^```python\n(.*?)^```$", PYTHON_PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert run(example, tmp_path).startswith("<Calibration: pass, rays within ")
    assert (tmp_path / "RESULT.json").exists()


def test_the_types_of_options_are_those_of_the_contracts():
    assert OPTION_TYPES.read_text() == option_types(), "run make docs"
    assert sawmill_calibration.__version__ == VERSION


@pytest.mark.slow
def test_a_type_checker_outside_finds_the_package_and_a_misspelt_option(tmp_path):
    head = "from sawmill_calibration import Scan, Theta, reconstruct\n\n\ndef make(scan: Scan, theta: Theta) -> None:"
    calls = ("size=128", "method='fbp'", "metod='fbp'", "method='fpb'")
    lines = [head, *(f"    reconstruct(scan, theta, {call})" for call in calls)]
    (tmp_path / "program.py").write_text("\n".join([*lines, ""]))
    (tmp_path / "page.py").write_text(PYTHON_PAGE.read_text().partition("```python\n")[2].partition("```")[0])
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--follow-imports=silent"]
    command += ["program.py", "page.py"]
    environment = {name: value for name, value in os.environ.items() if name not in {"MYPYPATH", "PYTHONPATH"}}
    checked = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    found = re.findall(r"^(\w+)\.py:(\d+): error: .*?(metod|fpb|$)", checked.stdout, re.MULTILINE)
    assert found == [("program", "7", "metod"), ("program", "8", "fpb")]
