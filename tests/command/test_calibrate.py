"""`sawmill calibrate`: its flags, its answers and its refusals."""

import json
import math
import shutil

import h5py
import numpy as np
import pytest
from PIL import Image

from sawmill_calibration.failures import JobFailure
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.calibrations import CalibrationFile
from sawmill_contracts.geometry import ScannerConstants
from sawmill_tomography.geometry.geometry import Scanner, Theta
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE

pytestmark = pytest.mark.slow

TRUTH = Theta(2.55, 714.7, 319.9, 43.7, 0.281)
SCANNER = Scanner(859.46, 256, 4.508593749)
KNOWN = ("--data", "line-integrals", "--source-to-cor-mm", 859.46)
L = ("--phantom", "l-shape")
BARE = (*KNOWN, "--detector-pitch-mm", 4.508593749, *L)


def calibrated(run, *arguments):
    return json.loads(run("calibrate", *arguments, "--json").stdout)


def error_mm(document) -> float:
    found = CalibrationFile.read(json.dumps(document)).source_frame
    return ray_error(SCANNER, TRUTH.source_frame(859.46), found).rms_mm


def test_the_answer_is_near_the_truth_and_reports_how_well_everything_is_known(result_file):
    document = json.loads(result_file.read_text())
    assert error_mm(document) < 0.05
    assert (document["state"], document["status"]) == ("succeeded", "calibrated")
    pitches = {"detector_pitch_mm": 4.508593749, "row_pitch_mm": 2.0, "object_turns": "in-one-scan"}
    straight = {"detector_modules": [], "detector_arc_radius_mm": None, "detector_waves_mm": []}
    assert document["scanner"] == {"source_to_cor_mm": 859.46, "num_detector_pixels": 256} | pitches | straight
    assert (document["views"], document["rows"], document["phantom"]) == (60, [0, 2], "L-shape")
    assert (document["handedness"], document["rotation"]) == ("as-drawn", "as-given")
    assert (document["search"]["seed"], len(document["input_sha256"])) == (7, 64)
    deviations = list(document["standard_deviation"]["theta"].values())
    np.testing.assert_allclose(np.sqrt(np.diag(document["theta_covariance"])), deviations)
    predicted = document["predicted_ray_error_mm"]
    low, high = predicted["interval_95"]
    assert low < predicted["rms"] < predicted["upper_95"] < high
    behind = [hypothesis["log_likelihood_behind"] for hypothesis in document["hypotheses"]]
    assert behind[0] == 0.0
    # The L from the wrong side leaves far more than noise: the choice is not close.
    assert min(behind[1:]) > 1000.0


def test_an_array_without_angles_and_pitch_takes_them_from_flags(run, bare_scan):
    assert error_mm(calibrated(run, bare_scan, *BARE, "--angles-deg", "3:6")) < 0.05


def test_fewer_views_keep_their_own_angles_and_flags_limit_what_is_tried(run, phantom_scan):
    limits = ("--handedness", "as-drawn", "--rotation", "as-given")
    document = calibrated(run, phantom_scan, *KNOWN, *L, "--views", 20, *limits)
    assert (document["views"], len(document["hypotheses"])) == (20, 1)
    assert error_mm(document) < 0.1
    assert abs(math.degrees(document["source_frame"]["psi_rad"] - TRUTH.source_frame(859.46).psi_rad)) < 0.2


def test_rows_are_averaged(run, phantom_scan, result_file):
    document = calibrated(run, phantom_scan, *KNOWN, *L, "--rows", "1:2")
    both = json.loads(result_file.read_text())
    assert document["rows"] == [1, 2]
    assert document["residual"]["relative"] / both["residual"]["relative"] == pytest.approx(math.sqrt(2), rel=0.05)


def test_what_is_not_to_be_done_is_named_as_often_as_needed(run, tmp_path):
    scan = tmp_path / "stack.h5"
    scanner = ("--source-to-cor-mm", "859.46", "--detector-pitch-mm", "4.508593749")
    body = ("log-with-phantom", "--theta", "2.55,714.7,319.9,43.7,0.281", *scanner, "--detector-pixels", 256)
    run("simulate", *body, "--views", 20, "--rows", 6, "--phantom-rows", 4, "-o", scan)
    flags = ("--data", "counts", "--source-to-cor-mm", 859.46, *L)
    found = calibrated(run, scan, *flags)
    assert (found["rows"], found["status"]) == ([0, 4], "calibrated")
    assert any("averaging of intensities" in adjustment for adjustment in found["adjustments"])
    named = calibrated(run, scan, *flags, "--rows", "0:4", "--without", "intensity-averaging", "--without", "blur")
    assert not any("averaging of intensities" in adjustment for adjustment in named["adjustments"])
    whole = calibrated(run, scan, *flags, "--without", "phantom-rows")
    assert whole["rows"] == [0, 6]
    # A third of the average is a log's.
    assert error_mm(whole) > 4.0 * error_mm(found)


def test_people_get_a_table_and_a_report_that_is_a_picture_or_a_page_as_its_name_says(run, phantom_scan, tmp_path):
    for name in ("out.png", "out.html"):
        table = run("calibrate", phantom_scan, *KNOWN, *L, "--views", 20, "--report", tmp_path / name).stdout
        assert "detector tilt alpha_D" in table
        assert "Calibration with L-shape" in table
    with Image.open(tmp_path / "out.png") as picture:
        assert picture.format == "PNG"
        assert min(picture.size) > 500
    page = (tmp_path / "out.html").read_text()
    assert page.startswith("<!doctype html>")
    assert page.count("data:image/svg+xml;base64,") >= 2
    assert phantom_scan.name in page


def test_a_phantom_may_be_a_picture_of_known_width(run, phantom_scan, tmp_path):
    Image.fromarray(np.rint(255 * L_SHAPE.rasterise(800, 400.0)).astype(np.uint8)).save(tmp_path / "l.png")
    document = calibrated(run, phantom_scan, *KNOWN, "--phantom", tmp_path / "l.png", "--phantom-width-mm", 400)
    assert error_mm(document) < 0.1


def test_the_published_search_has_its_own_switches(run, phantom_scan):
    flags = ("--method", "paper", "--paper-objective", "projection", "--paper-stop", "published", "--views", 12)
    document = calibrated(run, phantom_scan, *KNOWN, *L, *flags)
    assert document["standard_deviation"] is None
    assert document["search"]["evaluations"] > 100


def test_a_verdict_of_fail_is_an_answer(run, phantom_scan, tmp_path):
    half = [[1.01 * x, 0.93 * y] for x, y in L_SHAPE.shapes[0].vertices_mm]
    drawing = {"name": "not quite", "shapes": [{"kind": "polygon", "vertices_mm": half}]}
    (tmp_path / "l.json").write_text(json.dumps(drawing))
    document = calibrated(run, phantom_scan, *KNOWN, "--phantom", tmp_path / "l.json")
    assert document["verdict"] != "pass"
    assert document["reasons"]


def test_rows_beyond_the_free_memory_are_refused(failure, phantom_scan, tmp_path):
    """The file has room for a hundred million rows, of which none was ever written."""
    shutil.copy(phantom_scan, tmp_path / "tall.h5")
    with h5py.File(tmp_path / "tall.h5", "r+") as file:
        detector = file["entry/instrument/detector"]
        attributes = dict(detector["data"].attrs)
        del detector["data"]
        detector.create_dataset("data", (60, 10**8, 256), np.float32, chunks=(60, 1, 256)).attrs.update(attributes)
    reported = failure("calibrate", tmp_path / "tall.h5", *KNOWN, *L)
    assert reported["code"] == "too-large"
    assert "needs 6144000000000 bytes as float32" in reported["detail"]
    nothing = {"read": lambda *_: pytest.fail("something was read"), "remarks": (), "counts": False, "sha256": "0" * 64}
    scanner = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=256, detector_pitch_mm=4.5)
    every = {"rows": (0, 10**8), "usable_rows": (0, 10**8), "row_step": 1, "angles_rad": np.linspace(0.0, 6.0, 60)}
    rows = ScanRows(**nothing, **every, scanner=scanner, read_row=nothing["read"])
    needed = r"100000000 rows need 6144000000000 bytes in memory and \d+ are free; ask for fewer"
    with pytest.raises(JobFailure, match=needed):
        rows.stack()


def test_without_an_answer_the_object_reports_why(failure, bare_scan, phantom_scan, tmp_path):
    pitch = failure("calibrate", bare_scan, *KNOWN, *L, "--angles-deg", "3:6")
    assert pitch["code"] == "detector-pitch-missing"
    assert "--detector-pitch-mm" in pitch["detail"]
    (tmp_path / "text.h5").write_text("no scan")
    np.save(tmp_path / "noise.npy", np.random.default_rng(5).standard_normal((24, 1, 256)).astype(np.float32))
    np.save(tmp_path / "narrow.npy", np.ones((60, 1, 4), np.float32))
    narrow = failure("calibrate", tmp_path / "narrow.npy", *BARE, "--angles-deg", "3:6")
    assert (narrow["code"], "num_detector_pixels is 4" in narrow["detail"]) == ("out-of-range", True)
    for scan, flags, code in (
        (bare_scan, BARE, "angles-missing"),
        (phantom_scan, (*KNOWN, *L, "--rows", "1:3"), "rows-outside"),
        (phantom_scan, (*KNOWN, *L, "--views", 61), "views-too-many"),
        (phantom_scan, (*KNOWN, *L, "--angles-deg", "3:5"), "contradiction"),
        (phantom_scan, (*BARE[:-3], 4.5, *L), "contradiction"),
        (phantom_scan, (*BARE, "--row-pitch-mm", 3), "contradiction"),
        (tmp_path / "text.h5", BARE, "unknown-format"),
        (tmp_path / "noise.npy", (*BARE, "--angles-deg", "7.5:15"), "phantom-not-seen"),
    ):
        reported = failure("calibrate", scan, *flags)
        assert (reported["kind"], reported["code"]) == ("input", code)


def test_several_arrays_in_a_file_need_a_name(run, failure, bare_scan, tmp_path):
    with h5py.File(tmp_path / "two.h5", "w") as file:
        file["this"] = np.load(bare_scan)
        file["that"] = np.load(bare_scan)
    assert failure("calibrate", tmp_path / "two.h5", *BARE, "--angles-deg", "3:6")["code"] == "dataset-ambiguous"
    assert error_mm(calibrated(run, tmp_path / "two.h5", *BARE, "--angles-deg", "3:6", "--dataset", "that")) < 0.05


DISC = '{"kind": "disc", "center_mm": [0, 0], "radius_mm": -1}'


@pytest.mark.parametrize(
    ("name", "text", "flags", "code", "complaint"),
    [
        ("l.json", "{", (), "phantom", "is not a phantom's drawing"),
        ("l.json", '{"name": "x", "shapes": []}', (), "phantom", "shapes"),
        ("l.json", f'{{"name": "x", "shapes": [{DISC}]}}', (), "phantom", "radius_mm"),
        ("l.png", "no picture", ("--phantom-width-mm", 400), "picture-not-png", ""),
    ],
)
def test_a_file_that_is_no_phantom_is_refused(failure, phantom_scan, tmp_path, name, text, flags, code, complaint):
    (tmp_path / name).write_text(text)
    reported = failure("calibrate", phantom_scan, *KNOWN, "--phantom", tmp_path / name, *flags)
    assert reported["code"] == code
    assert complaint in reported["detail"]


def test_refusals_are_one_sentence_for_people(run, bare_scan):
    result = run("calibrate", bare_scan, *BARE, code=1)
    assert result.stdout == ""
    assert result.stderr.startswith("angles-missing: the file carries no angles; give the angles")
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("flags", "complaint"),
    [
        ((*KNOWN,), "Missing option '--phantom'"),
        (("--source-to-cor-mm", 859.46, *L), "Missing option '--data'"),
        (("--data", "counts", *L), "Missing option '--source-to-cor-mm'"),
        (("--data", "numbers", "--source-to-cor-mm", 859.46, *L), "'numbers' is not one of"),
        (("--data", "counts", "--source-to-cor-mm", "nan", *L), "should be less than or equal to 100000"),
        (("--data", "counts", "--source-to-cor-mm", 0, *L), "should be greater than or equal to 1"),
        ((*KNOWN, *L, "--detector-pitch-mm", -1), "must be above 0 and at most 100000, not -1.0"),
        ((*KNOWN, *L, "--angles-deg", "one:two"), "an angle must be a number of degrees"),
        ((*KNOWN, *L, "--angles-deg", "0:0"), "must not be 0 degrees"),
        ((*KNOWN, *L, "--angles-deg", "3:6", "--angles-file", __file__), "not both"),
        ((*KNOWN, *L, "--rows", "4:4"), "'--rows': rows must be A:B"),
        ((*KNOWN, *L, "--views", 2), "--views"),
        ((*KNOWN, *L, "--seed", -1), "--seed"),
        ((*KNOWN, *L, "--handedness", "left"), "'left' is not one of"),
        ((*KNOWN, *L, "--method", "guess"), "'guess' is not one of"),
        ((*KNOWN, *L, "--without", "noise"), "'noise' is not one of"),
        ((*KNOWN, *L, "--paper-stop", "tight"), "--paper-stop comes with --method paper"),
        ((*KNOWN, *L, "--phantom-width-mm", 400), "a built-in phantom has its size"),
        ((*KNOWN, "--phantom", "cross"), "'--phantom': must be l-shape, rectangle-with-hole or an existing file"),
        ((*KNOWN, *L, "--report", "no/such/folder/out.png"), "there is no folder 'no/such/folder'"),
    ],
)
def test_wrong_use_is_found_before_the_scan_is_read(wrong_use, tmp_path, flags, complaint):
    scan = tmp_path / "scan.h5"
    scan.write_text("whoever reads this finds that it is no scan")
    assert complaint in wrong_use("calibrate", scan, *flags)


def test_a_picture_needs_its_width_a_drawing_none_and_every_scan_its_file(wrong_use, bare_scan, tmp_path):
    (tmp_path / "l.png").touch()
    (tmp_path / "l.json").touch()
    assert "give --phantom-width-mm" in wrong_use("calibrate", bare_scan, *KNOWN, "--phantom", tmp_path / "l.png")
    drawing = ("--phantom", tmp_path / "l.json", "--phantom-width-mm", 400)
    assert "a drawing is in mm already" in wrong_use("calibrate", bare_scan, *KNOWN, *drawing)
    assert "does not exist" in wrong_use("calibrate", tmp_path / "none.h5", *BARE)
