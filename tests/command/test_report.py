"""`sawmill report`: from RESULT.json or result.h5 to one HTML page."""

import json

import h5py
import numpy as np
import pytest
from calibration_answers import write_answer
from results import calibration_result

from sawmill_contracts.calibrations import CalibrationFile, CalibrationResult
from sawmill_formats.output.calibration_file import NamedArray, write_calibration

VIEWS, CELLS = 8, 12
ARRAYS = {
    "sinogram": np.ones((VIEWS, CELLS)),
    "model": np.ones((VIEWS, CELLS)),
    "residual": np.ones((VIEWS, CELLS)),
    "angles_rad": np.linspace(0.0, 5.5, VIEWS),
    "phantom_image": np.eye(16),
    "phantom_field_mm": np.array(200.0),
    "phantom_outlines_mm": np.array([(-50.0, -50.0), (50.0, 0.0), (-50.0, -50.0)]),
    "search_history": np.array([(1.0, 0.5), (2.0, 0.001)]),
    "phantom_image_method": np.array(b"fbp"),
}


@pytest.fixture
def answer():
    return CalibrationResult.model_validate(calibration_result(phantom="our <cross>"))


@pytest.fixture
def hdf5(tmp_path, answer):
    """A result.h5 with its arrays, of which some may be left out or replaced."""

    def write(**changes):
        arrays = {name: values for name, values in (ARRAYS | changes).items() if values is not None}
        path = tmp_path / "result.h5"
        named = {name: NamedArray(values, "1", "") for name, values in arrays.items()}
        write_calibration(path, answer.model_dump(mode="json"), named, software_version="0", input_sha256="0" * 64)
        return path

    return write


def test_a_report_of_result_h5_has_the_pictures_and_the_day(run, hdf5, tmp_path):
    path = hdf5()
    done = run("report", path, "-o", tmp_path / "report.html")
    assert "a report of two pages" in done.stderr
    assert done.stdout == ""
    html = (tmp_path / "report.html").read_text()
    assert html.count("data:image/svg+xml;base64,") == 3
    assert "Calibration with our &lt;cross&gt;" in html
    with h5py.File(path) as file:
        year = file["entry/start_time"][()][:4].decode()
    assert f"<dt>Made</dt><dd>{year}-" in html


@pytest.mark.parametrize("beside", [{}, {"scan_id": "monday", "created_at": "2026-11-22T16:44:00+00:00"}])
def test_a_report_of_result_json_says_that_it_has_no_pictures(run, answer, tmp_path, beside):
    path = tmp_path / "RESULT.json"
    path.write_text(json.dumps(CalibrationFile.of(answer).model_dump(mode="json") | beside))
    done = run("report", path, "-o", tmp_path / "report.html")
    assert "has no pictures of the scan" in " ".join(done.stderr.split())
    html = (tmp_path / "report.html").read_text()
    assert "data:image" not in html
    assert ("monday" in html) is bool(beside)
    assert ("<dt>Made</dt><dd>2026-11-2" in html) is bool(beside)


def test_an_hdf5_file_with_the_answer_alone_is_as_good_as_json(run, answer, tmp_path):
    write_answer(tmp_path / "bare.h5", answer)
    assert "has no pictures" in run("report", tmp_path / "bare.h5", "-o", tmp_path / "report.html").stderr


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"residual": None}, "it has no /entry/arrays/residual, which the pictures need"),
        ({"angles_rad": np.zeros(3)}, "the residual (8, 12) and 3 angles do not agree"),
        ({"phantom_image_method": np.array(b"magic")}, "'magic' is not a valid ReconstructionMethod"),
        ({"phantom_image": np.full((16, 16), np.nan)}, "not finite"),
        ({"residual": np.ones(5)}, "residual must be numbers on 2 axes, not float64 on 1"),
        ({"phantom_field_mm": np.ones(7)}, "phantom_field_mm must be one number, not float64 of shape (7,)"),
    ],
)
def test_damaged_arrays_are_refused_in_one_sentence(run, hdf5, tmp_path, changes, reason):
    done = run("report", hdf5(**changes), "-o", tmp_path / "report.html", code=1)
    assert reason in " ".join(done.stderr.split())
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("time", ["9999-12-31T23:59:59-14:00", "0001-01-01T00:00:00+14:00"])
def test_a_time_beyond_the_calendar_is_refused_in_one_sentence(run, answer, tmp_path, time):
    path = tmp_path / "RESULT.json"
    path.write_text(json.dumps(CalibrationFile.of(answer).model_dump(mode="json") | {"created_at": time}))
    done = run("report", path, "-o", tmp_path / "report.html", code=1)
    assert f"RESULT.json was made at {time}, which" in " ".join(done.stderr.split())


def test_what_is_no_calibration_is_refused(run, tmp_path):
    (tmp_path / "other.json").write_text("[]")
    done = run("report", tmp_path / "other.json", "-o", tmp_path / "report.html", code=1)
    assert "it is not a calibration that succeeded" in " ".join(done.stderr.split())
