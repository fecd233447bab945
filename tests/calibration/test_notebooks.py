"""The notebooks in examples/ run from the first cell to the last, and are kept with their outputs."""

import json
import os
import re
import sys
from itertools import zip_longest

import nbformat
import pytest
from missing_parts import first_by_day
from nbclient import NotebookClient
from notebooks import EXAMPLES, MEASURED, TIME_ROW, clean
from scan_files import published_data  # noqa: F401 - fixture

LARGEST_BYTES = 1_000_000
# Sums in another order, by other threads or processors, move an answer by much less than its standard deviation, so
# the last digits that are shown. A bound that a change of the code moves by 2 % is seen.
RELATIVE, LAST_DIGITS = 0.005, 2
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
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
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, kernel_name=kernel, timeout=120, resources={"metadata": {"path": str(folder)}}).execute()
    assert not [output for cell in code_of(notebook) for output in cell.outputs if output.get("name") == "stderr"]
    return notebook


def code_of(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def shown(notebook):
    """The first kind of each output, cell by cell: how a reader sees them."""
    kinds = ("image/png", "text/html", "text/plain")

    def kind_of(output):
        return next((kind for kind in kinds if kind in output.get("data", {})), output.output_type)

    return [[kind_of(output) for output in cell.outputs] for cell in code_of(notebook)]


def printed(notebook):
    outputs = [(output, output.get("data", {})) for cell in code_of(notebook) for output in cell.outputs]
    texts = [output.get("text") or data.get("text/html") or data.get("text/plain", "") for output, data in outputs]
    return " ".join(re.sub(r"<[^>]*>", " ", TIME_ROW.sub("", text)) for text in texts).split()


def differences(now, kept):
    """Pairs of words that differ, or whose numbers differ by more than arithmetic does."""
    return [pair for pair in zip_longest(now, kept, fillvalue="") if not agree(*pair)]


def agree(now, kept):
    numbers = list(zip(NUMBER.findall(now), NUMBER.findall(kept), strict=False))
    last = [10.0 ** -len(number.partition(".")[2]) for _, number in numbers]
    near = [
        abs(float(a) - float(b)) <= RELATIVE * abs(float(b)) + LAST_DIGITS * digit * (digit < 1.0)
        for (a, b), digit in zip(numbers, last, strict=True)
    ]
    return NUMBER.sub("#", now) == NUMBER.sub("#", kept) and all(near)


@pytest.mark.parametrize(
    ("now", "kept", "same"),
    [
        ("0.0281", "0.0280", True),
        ("0.0324", "0.0280", False),
        ("714.2240", "714.2226", True),
        ("(0.01,", "(-0.01,", True),
        ("14", "15", False),
        ("pass", "watch", False),
        ("0:1", "0", False),
    ],
)
def test_a_printed_number_may_differ_by_arithmetic_alone(now, kept, same):
    assert agree(now, kept) is same


@pytest.mark.slow
@pytest.mark.parametrize("path", first_by_day(1, NOTEBOOKS[::-1]), ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_it_is_kept_with(path, kernel, tmp_path):
    kept, now = nbformat.read(path, as_version=4), run(path, kernel, tmp_path)
    assert shown(now) == shown(kept), "run `make notebooks`"
    assert differences(printed(now), printed(kept)) == [], "run `make notebooks`"


@pytest.mark.nightly
def test_the_notebook_of_a_measured_disc_runs_and_draws(published_data, kernel, tmp_path, monkeypatch):  # noqa: F811 - the fixture
    if not (published_data / "measured-discs").is_dir():
        pytest.skip(f"the measured discs are not in {published_data}: docs/understand/measured.md has how to get them")
    monkeypatch.setenv("SAWMILL_PUBLISHED_DATA", str(published_data.resolve()))
    kept, now = nbformat.read(MEASURED, as_version=4), run(MEASURED, kernel, tmp_path)
    assert shown(now) == shown(kept)
    remedy = "run `python docs/tools/measured_pictures.py --only notebook`"
    assert differences(printed(now), printed(kept)) == [], remedy


@pytest.mark.parametrize("path", [*NOTEBOOKS, MEASURED], ids=lambda path: path.stem)
def test_a_notebook_is_kept_with_its_outputs_in_order(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = code_of(notebook)
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert {"text/html", "image/png"} <= {kind for output in outputs for kind in output.get("data", {})}
    assert path.stat().st_size < LARGEST_BYTES


@pytest.mark.parametrize("path", [*NOTEBOOKS, MEASURED], ids=lambda path: path.stem)
def test_kept_outputs_have_neither_times_nor_paths_of_a_machine(path):
    assert len(NOTEBOOKS) == 2, "those of simulated scans"
    notebook = nbformat.read(path, as_version=4)
    before = json.dumps([cell.get("outputs") for cell in notebook.cells], sort_keys=True)
    outputs = [output for cell in code_of(notebook) for output in cell.outputs if "data" in output]
    pictures = [output.data.pop("image/png", None) for output in outputs]
    assert any(pictures)
    without_pictures = json.dumps([cell.get("outputs") for cell in notebook.cells], sort_keys=True)
    clean(notebook)
    cleaned = json.dumps([cell.get("outputs") for cell in notebook.cells], sort_keys=True)
    assert cleaned == without_pictures != before, "run `make notebooks`"


def test_a_path_of_a_machine_in_an_output_is_refused():
    output = nbformat.v4.new_output("stream", text="saved in /" + "home/someone/result.json")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("run()", outputs=[output])])
    with pytest.raises(ValueError, match="absolute path"):
        clean(notebook)
