"""`sawmill drift`: what moved since a calibration, from a log's scan."""

import json
import re

import pytest

from sawmill_contracts.calibrations import CalibrationFile
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.geometry import ScannerConstants
from sawmill_vocabulary import Theta

pytestmark = pytest.mark.slow

THETA = "2.55,714.7,319.9,43.7,0.281"
MOVED = "2.55,714.7,317.9,45.7,0.281"  # the turntable 2 mm along x
SCANNER = ("--source-to-cor-mm", 859.46, "--detector-pitch-mm", 3.0)


@pytest.fixture(scope="session")
def log_scans(run, scans):
    """Counts of a log before and after the turntable moved, and in few views."""
    folder = scans / "drift"
    folder.mkdir()
    for name, theta, views in (("still", THETA, 180), ("moved", MOVED, 180), ("sparse", MOVED, 60)):
        flags = ("--detector-pixels", 384, "--views", views, "--rows", 2, "--seed", 3)
        run("simulate", "log", "--theta", theta, *SCANNER, *flags, "-o", folder / f"{name}.h5")
    return folder


@pytest.fixture(scope="session")
def known(result_file, scans):
    found = CalibrationFile.read(result_file.read_text())
    theta = Theta.from_vector(map(float, THETA.split(",")))
    scanner = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=384, detector_pitch_mm=3.0)
    exact = {"theta": theta, "source_frame": theta.source_frame(859.46), "covariance": None, "scanner": scanner}
    path = scans / "known.json"
    path.write_text(CalibrationFile(id="known", **dict(found.model_copy(update=exact))).model_dump_json())
    return path


def test_a_scanner_that_stood_still_is_within_tolerance_and_a_turntable_that_moved_reported_in_words(
    run, log_scans, known
):
    answer = run("drift", log_scans / "still.h5", "--data", "counts", "--calibration", known, "--json")
    document = json.loads(answer.stdout)
    assert document.pop("state") == "succeeded"
    result = DriftResult.model_validate(document)
    assert result.within_tolerance
    assert abs(result.change.cor_column_mm) < 4.0 * result.change_standard_deviation.cor_column_mm
    assert (result.views, result.rows, result.tolerance_mm) == (180, (0, 2), 0.5)
    flags = ("--data", "counts", "--calibration", known, "--rows", "0:1", "--tolerance-mm", "0.6")
    reported = " ".join(run("drift", log_scans / "moved.h5", *flags).stdout.split())
    for words in ("out of tolerance", "Look at the turntable", "not seen: the distance R"):
        assert words in reported


NOMINAL = "2.55,714.7,319.9,200,0.281"  # h_D wrong by a seventh of the detector


def test_nominal_distances_are_enough_for_the_centre_of_rotation_and_to_reconstruct(run, log_scans, tmp_path):
    scan, flags = log_scans / "sparse.h5", ("--data", "counts", "--source-to-cor-mm", 859.46, "--views", 20)
    result = json.loads(run("drift", scan, *flags, "--theta", NOMINAL, "--json").stdout)
    true, found = Theta.from_vector(map(float, MOVED.split(","))), Theta(**result["theta"])
    frame, expected = found.source_frame(859.46), true.source_frame(859.46)
    assert abs(frame.cor_column_mm - expected.cor_column_mm) < 4.0 * result["standard_deviation"]["cor_column_mm"] < 2.0
    kept = (expected.source_distance_mm, expected.psi_rad)
    assert (frame.source_distance_mm, frame.psi_rad) == pytest.approx(kept, rel=2e-3)
    assert (result["reference"], result["moved"], result["within_tolerance"]) == ("given-geometry", False, None)
    (printed,) = re.findall(r"reconstruct with --theta (\S+), in which", result["reason"])
    used = run("reconstruct", scan, *flags, "--theta", printed, "--size", 32, "-o", tmp_path / "v.h5", "--json").stdout
    assert list(json.loads(used)["theta"].values()) == pytest.approx(list(result["theta"].values()), rel=1e-5)


def test_nominal_distances_raise_no_alarm_and_have_no_baseline(run, wrong_use, log_scans):
    flags = ("--data", "counts", "--theta", NOMINAL, "--source-to-cor-mm", 859.46)
    table = run("drift", log_scans / "sparse.h5", *flags, "--views", 20).stdout
    assert "Centre of rotation" in table
    assert "tolerance" not in table
    refused = wrong_use("drift", log_scans / "still.h5", *flags, "--baseline", log_scans / "still.h5")
    assert "--baseline comes with --calibration" in refused


def test_a_baseline_of_earlier_answers_is_the_zero_of_the_change(run, failure, log_scans, known, tmp_path):
    flags = ("--data", "counts", "--calibration", known, "--json")
    still = json.loads(run("drift", log_scans / "still.h5", *flags).stdout)
    answers = [tmp_path / f"{number}.json" for number in range(3)]
    for number, path in enumerate(answers):
        path.write_text(json.dumps(still | {"input_sha256": f"{number:064}"}))
    given = [word for path in answers for word in ("--baseline", path)]
    reported = json.loads(run("drift", log_scans / "still.h5", *flags, *given).stdout)
    assert (reported["reference"], reported["baseline"]["checks"], reported["moved"]) == ("baseline", 3, False)
    assert reported["baseline"]["change"]["cor_column_mm"] == pytest.approx(0.0, abs=1e-6)
    assert reported["baseline"]["last_at"] == still["at"]
    assert 0.0 < reported["baseline"]["age_hours"] < 1.0
    assert failure("drift", log_scans / "still.h5", *flags[:-1], "--baseline", known)["code"] == "baseline"


def test_wrong_use(wrong_use, log_scans, known):
    scan = (log_scans / "still.h5", "--data", "counts")
    assert "--calibration" in wrong_use("drift", *scan)
    assert "rows must be A:B" in wrong_use("drift", *scan, "--calibration", known, "--rows", "3")
    averaged = wrong_use("drift", *scan, "--averaged-rows", 2, "--calibration", known)
    assert "averaged_rows goes with line-integrals, not counts" in averaged
