"""The notebooks in examples/ run from the first cell to the last."""

import json
import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from scan_files import published_data  # noqa: F401 - fixture
from tiers import first_by_day

EXAMPLES = Path(__file__).parents[2] / "examples"
# Needs data that are not everywhere, and so is kept with its outputs.
MEASURED = EXAMPLES / "measured-disc.ipynb"
LARGEST_BYTES = 1_000_000
NOTEBOOKS = sorted(set(EXAMPLES.glob("*.ipynb")) - {MEASURED})


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """The name of a kernel that is this interpreter and finds its modules where this one does."""
    folder = tmp_path / "jupyter/kernels/under-test"
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    paths = {"PYTHONPATH": os.pathsep.join(sys.path)}
    spec = {"argv": command, "display_name": "under test", "language": "python", "env": paths}
    (folder / "kernel.json").write_text(json.dumps(spec))
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "jupyter"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "runtime"))
    return "under-test"


def run(path, kernel, folder):
    """Run a notebook from its first cell to its last, and give the kinds of its outputs."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, kernel_name=kernel, timeout=120, resources={"metadata": {"path": str(folder)}})
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    return {kind for output in outputs for kind in output.get("data", {})}


@pytest.mark.slow
@pytest.mark.parametrize("path", first_by_day(1, NOTEBOOKS[::-1]), ids=lambda path: path.stem)
def test_a_notebook_runs_and_draws(path, kernel, tmp_path):
    assert {"text/html", "image/png"} <= run(path, kernel, tmp_path)


@pytest.mark.nightly
def test_the_notebook_of_a_measured_disc_runs_and_draws(published_data, kernel, tmp_path, monkeypatch):  # noqa: F811 - the fixture
    if not (published_data / "measured-discs").is_dir():
        pytest.skip(f"the measured discs are not in {published_data}: docs/understand/measured.md has how to get them")
    monkeypatch.setenv("SAWMILL_PUBLISHED_DATA", str(published_data.resolve()))
    assert {"text/html", "image/png"} <= run(MEASURED, kernel, tmp_path)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs(path):
    code = code_of(path)
    assert not [cell for cell in code if cell.outputs or cell.execution_count is not None]


def test_the_notebook_of_a_measured_disc_is_kept_with_its_outputs_in_order():
    code = code_of(MEASURED)
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert not [output for cell in code for output in cell.outputs if output.output_type == "error"]
    assert MEASURED.stat().st_size < LARGEST_BYTES


def code_of(path):
    """The cells of code of a valid notebook."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert code
    return code


def test_there_are_two_notebooks_beside_it():
    assert len(NOTEBOOKS) == 2
