"""Answers of a calibration as files: --calibration takes either of them, `sawmill report` makes one HTML page."""

import json
import math
import struct

import h5py
import numpy as np
import pytest
from PIL import Image
from results import calibration_result, write_answer

from sawmill_contracts.calibrations import CalibrationFile, CalibrationResult
from sawmill_formats.output.calibration_file import NamedArray, write_calibration

MOST_BYTES = 16 * 2**20


def volume(path) -> np.ndarray:
    with h5py.File(path) as file:
        return file["entry/reconstruction/data"][()]


def test_result_h5_alone_is_enough_to_reconstruct(run, stack, result_file, result_hdf5, tmp_path):
    flags = ("--data", "counts", "--rows", "2:3", "--method", "fbp")
    run("reconstruct", stack, *flags, "--calibration", result_file, "-o", tmp_path / "json.h5")
    run("reconstruct", stack, *flags, "--calibration", result_hdf5, "-o", tmp_path / "hdf5.h5")
    assert np.array_equal(volume(tmp_path / "json.h5"), volume(tmp_path / "hdf5.h5"))


JSON = "entry/calibration_json"


def hdf5_of(value, name=JSON):
    """Write HDF5 with this value, or with one that is made of the result's file."""

    def write(path, result):
        with h5py.File(path, "w") as file:
            file[name] = value(result) if callable(value) else value

    return write


def incomplete(result):
    with h5py.File(result) as file:
        known = json.loads(file[JSON][()])
    known["theta"].pop("detector_tilt")
    return json.dumps(known)


def text_of(shape, kind, **storage):
    """Write HDF5 with a text that is stored so, and was never written."""

    def write(path, _result):
        with h5py.File(path, "w") as file:
            file.create_dataset(JSON, shape, kind, **storage)

    return write


def text_that_claims_more_than_there_is(path, _result):
    with h5py.File(path, "w") as file:
        file[JSON] = "{}".ljust(1234)
        at = file[JSON].id.get_offset()
    whole = bytearray(path.read_bytes())
    assert struct.unpack_from("<I", whole, at) == (1234,)
    struct.pack_into("<I", whole, at, 0xFFFF_FFF0)
    path.write_bytes(whole)


def huge_json(path, _result):
    with path.open("wb") as stream:
        stream.truncate(3 * 2**30)


PACKED = {"chunks": (2**20,), "maxshape": (None,), "compression": "gzip"}


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (lambda path, _: Image.new("L", (32, 32), 128).save(path, format="PNG"), "it is neither JSON nor HDF5"),
        (hdf5_of(np.zeros((4, 4)), "entry/data"), "it is HDF5 without /entry/calibration_json"),
        (lambda path, result: path.write_bytes(result.read_bytes()[:-100]), "truncated file"),
        (hdf5_of(3.0), "it is HDF5 without /entry/calibration_json"),
        (hdf5_of("no JSON"), "Invalid JSON"),
        (hdf5_of(incomplete), "theta.detector_tilt: Field required"),
        (hdf5_of(lambda result: h5py.ExternalLink(str(result), f"/{JSON}")), "leads through an external link"),
        (text_of((), f"S{MOST_BYTES + 1}"), "16777217 bytes"),
        (text_of((1,), "S1024", **PACKED), "1073741824 bytes"),
        (text_that_claims_more_than_there_is, "4294967280 bytes"),
        (lambda path, _: path.write_text("[" * 2**20), "it is neither JSON nor HDF5"),
        (huge_json, "it has more than 16777216 bytes"),
    ],
)
def test_what_is_neither_is_refused_in_one_sentence(failure, stack, result_hdf5, tmp_path, write, reason):
    path = tmp_path / "given"
    write(path, result_hdf5)
    flags = ("--data", "counts", "--calibration", path, "-o", tmp_path / "out.h5")
    reported = failure("reconstruct", stack, *flags)
    assert (reported["kind"], reported["code"]) == ("input", "calibration")
    neither = "given is neither what calibrate --json prints nor a calibration's result.h5: "
    assert reported["detail"].startswith(neither)
    assert reason in reported["detail"]
    assert "\n" not in reported["detail"]
    assert not (tmp_path / "out.h5").exists()


VIEWS, CELLS = 8, 12
ARRAYS = dict.fromkeys(("sinogram", "model", "residual"), np.ones((VIEWS, CELLS))) | {
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


def hdf5(tmp_path, answer, **changes):
    """A result.h5 with its arrays, of which some may be left out or replaced."""
    arrays = {name: values for name, values in (ARRAYS | changes).items() if values is not None}
    path = tmp_path / "result.h5"
    named = {name: NamedArray(values, "1", "") for name, values in arrays.items()}
    write_calibration(path, answer.model_dump(mode="json"), named, software_version="0", input_sha256="0" * 64)
    return path


def test_a_report_of_result_h5_has_the_pictures_and_the_day(run, answer, tmp_path):
    path = hdf5(tmp_path, answer)
    done = run("report", path, "-o", tmp_path / "report.html")
    assert "a report to print" in done.stderr
    assert done.stdout == ""
    html = (tmp_path / "report.html").read_text()
    assert html.count("data:image/svg+xml;base64,") == 3
    assert "Calibration with our &lt;cross&gt;" in html
    with h5py.File(path) as file:
        year = file["entry/start_time"][()][:4].decode()
    assert f"<dt>Made</dt><dd>{year}-" in html


def test_the_budget_of_either_file_is_the_same(run, result_file, result_hdf5, answer, tmp_path):
    printed = run("budget", result_hdf5).stdout
    assert printed == run("budget", result_file).stdout
    noise = next(
        line for line in json.loads(result_file.read_text())["uncertainty_budget"] if line["source"] == "noise"
    )
    assert noise["rays_mm_per_unit"] * noise["standard_uncertainty"] == pytest.approx(noise["rays_mm"])
    assert f"{noise['rays_mm']:.3g}" in next(line for line in printed.splitlines() if "noise of the samples" in line)
    assert "no accreditation" in printed
    (tmp_path / "earlier.json").write_text(CalibrationFile.of(answer).model_dump_json())
    assert "no uncertainty budget" in run("budget", tmp_path / "earlier.json", code=1).stderr


def test_stated_moisture_and_temperature_count_in_the_budget(run, result_file):
    before = json.loads(result_file.read_text())["scale_uncertainty_percent"]
    stated = ["--moisture-percent", "28", "34", "1", "--temperature-c", "20", "5", "0.5"]
    answer = json.loads(run("budget", result_file, *stated, "--json").stdout)
    lines = {line["source"]: line for line in answer["uncertainty_budget"]}
    # Above 30 % moisture changes nothing more.
    assert lines["moisture"]["change"] == 2.0
    assert lines["moisture"]["scale_percent"] == pytest.approx(0.25 * math.hypot(2.0, 1.0))
    assert lines["temperature"]["scale_percent"] == pytest.approx(0.003 * math.hypot(15.0, 0.5))
    summed = [line for line in lines.values() if line["counted_in"] == "sum"]
    assert {"moisture", "temperature", "phantom-size"} <= {line["source"] for line in summed}
    assert sum(line["scale_share_percent"] for line in summed) == pytest.approx(100.0)
    bound = math.hypot(before, *(1.96 * lines[name]["scale_percent"] for name in ("moisture", "temperature")))
    printed = " ".join(run("budget", result_file, *stated).stdout.split())
    assert f"the 95 % bound is {bound:.3g} %, 1.96 times the sum" in printed
    assert "The phantom has grown by +0.455 %" in printed
    assert "has grown" not in run("budget", result_file).stdout


@pytest.mark.parametrize("stated", [("9", "12", "-1"), ("9", "nan", "1")])
def test_a_change_that_is_none_is_wrong_use(run, result_file, stated):
    printed = " ".join(run("budget", result_file, "--moisture-percent", *stated, code=2).stderr.split())
    assert "must be three finite numbers" in printed.replace(" │ │ ", " ")


@pytest.mark.parametrize("beside", [{}, {"scan_id": "monday", "created_at": "2026-11-22T16:44:00+00:00"}])
def test_a_report_of_an_answer_alone_says_that_it_has_no_pictures(run, answer, tmp_path, beside):
    path = tmp_path / "RESULT.json"
    path.write_text(json.dumps(CalibrationFile.of(answer).model_dump(mode="json") | beside))
    assert "has no pictures of the scan" in " ".join(run("report", path, "-o", tmp_path / "report.html").stderr.split())
    html = (tmp_path / "report.html").read_text()
    assert "data:image" not in html
    assert ("monday" in html) is bool(beside)
    assert ("<dt>Made</dt><dd>2026-11-2" in html) is bool(beside)
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
def test_damaged_arrays_are_refused_in_one_sentence(run, answer, tmp_path, changes, reason):
    assert reason in " ".join(
        run("report", hdf5(tmp_path, answer, **changes), "-o", tmp_path / "report.html", code=1).stderr.split()
    )
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("time", ["9999-12-31T23:59:59-14:00", "0001-01-01T00:00:00+14:00"])
def test_a_time_beyond_the_calendar_and_what_is_no_calibration_are_refused_in_one_sentence(run, answer, tmp_path, time):
    path = tmp_path / "RESULT.json"
    path.write_text(json.dumps(CalibrationFile.of(answer).model_dump(mode="json") | {"created_at": time}))
    done = run("report", path, "-o", tmp_path / "report.html", code=1)
    assert f"RESULT.json was made at {time}, which" in " ".join(done.stderr.split())
    path.write_text("[]")
    done = run("report", path, "-o", tmp_path / "report.html", code=1)
    assert "it is not a calibration that succeeded" in " ".join(done.stderr.split())
