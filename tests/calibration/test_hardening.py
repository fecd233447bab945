"""The hardening that a calibration found is taken out of a log's line integrals, and the answer says so."""

import json

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import sawmill_calibration as sawmill
from sawmill_command.commands import main

pytestmark = pytest.mark.slow

SCANNER = sawmill.Scanner(859.46, 256, 4.508593749)
THETA = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
# 10 % of hardening on the phantom's longest path.
BEAM = {"beam": {"energy_spread": 0.5}}
LOG = sawmill.Phantom("log", (sawmill.Disc((0.0, 0.0), 140.0),))
ASKED = {"field_mm": 400.0, "size": 128}


@pytest.fixture(scope="module")
def calibration():
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=24, physics=BEAM, seed=3)
    return sawmill.calibrate(scan, "l-shape")


@pytest.fixture(scope="module")
def log():
    return sawmill.simulate_phantom_scan(LOG, SCANNER, THETA, views=60, physics=BEAM, seed=4)


def test_cells_that_are_left_out_of_a_calibration_have_no_part_in_its_hardening(calibration):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=24, physics=BEAM, seed=3)
    lines = scan.line_integrals.copy()
    lines[..., 130] *= 3.0
    faulty = sawmill.Scan.from_arrays(lines, scan.angles_rad, SCANNER, from_counts=True)
    found = sawmill.calibrate(faulty, "l-shape").result.beam_hardening
    # With that cell's samples it would be 14 % more.
    assert found.spread == pytest.approx(calibration.result.beam_hardening.spread, rel=0.01)


def cupping(image):
    """How much darker the middle of the disc is than its rim."""
    x = (np.arange(128) - 63.5) * 400.0 / 128
    radius = np.hypot(x[:, None], x)
    return 1.0 - image[radius < 40.0].mean() / image[(radius > 105.0) & (radius < 130.0)].mean()


def test_a_disc_is_flat_with_the_hardening_taken_out_and_darker_in_the_middle_without(calibration, log):
    found = calibration.result.beam_hardening
    assert found.from_counts
    straight = sawmill.reconstruct(log, calibration, **ASKED)
    bent = sawmill.reconstruct(log, calibration, hardening="none", **ASKED)
    assert cupping(bent.image) > 0.05
    # Of which views and photons are 1 %.
    assert abs(cupping(straight.image)) < 0.02
    (done,) = set(straight.result.preparation) - set(bent.result.preparation)
    assert done.startswith("beam hardening of -")
    assert done.endswith("was taken out")


def test_a_log_whose_middle_row_shows_nothing_is_reconstructed(calibration, log):
    row = log.line_integrals
    stack = np.concatenate([row, np.zeros_like(row), row], axis=1)
    rows = sawmill.Scan.from_arrays(stack, log.angles_rad, SCANNER, from_counts=True)
    found = sawmill.reconstruct(rows, calibration, method="fbp", **ASKED)
    assert "beam hardening, as the calibration found it, was taken out" in found.result.preparation
    one = sawmill.reconstruct(log, calibration, method="fbp", **ASKED)
    np.testing.assert_array_equal(found.volume[0], one.image)


def test_the_command_corrects_and_says_so_in_the_volume(calibration, log, tmp_path):
    calibration.save(tmp_path / "RESULT.json")
    np.save(tmp_path / "log.npy", log.line_integrals)
    flags = ["--data", "line-integrals", "--angles-deg", "3:6", "--calibration", str(tmp_path / "RESULT.json")]
    made = ["--size", "32", "-o", str(tmp_path / "log.h5"), "--json"]
    done = CliRunner().invoke(main, ["reconstruct", str(tmp_path / "log.npy"), *flags, *made])
    assert done.exit_code == 0, done.output
    # The calibration's scan was of counts, and these line integrals may have been corrected already.
    (sentence,) = (each for each in json.loads(done.stdout)["preparation"] if "hardening" in each)
    assert "was not taken out" in sentence
    with h5py.File(tmp_path / "log.h5") as file:
        written = []
        file.visititems(lambda _, item: written.append(str(item[()])) if isinstance(item, h5py.Dataset) else None)
    assert any(sentence in text for text in written)
