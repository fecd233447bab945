"""The hardening and the scatter that a calibration found are taken out of a log's line integrals."""

import json

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import sawmill_calibration as sawmill
from sawmill_command.commands import main
from sawmill_tomography.sinograms.scattered_radiation import with_scatter, without_scatter
from sawmill_vocabulary.scattered_radiation import ScatteredRadiation

SCANNER = sawmill.Scanner(859.46, 256, 4.508593749)
THETA = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
# 10 % of hardening on the phantom's longest path.
BEAM = {"beam": {"energy_spread": 0.5}}
ATTENUATION, FIELD_MM, SIZE = 0.018, 400.0, 128
ASKED = {"field_mm": FIELD_MM, "size": SIZE}


def calibrated(physics):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=24, physics=physics, seed=3)
    return sawmill.calibrate(scan, "l-shape")


def disc(radius_mm, physics, seed):
    body = sawmill.Phantom("log", (sawmill.Disc((0.0, 0.0), radius_mm),))
    return sawmill.simulate_phantom_scan(body, SCANNER, THETA, views=60, physics=physics, seed=seed)


def cupping_and_level(image, radius_mm):
    x = (np.arange(SIZE) - 0.5 * (SIZE - 1)) * FIELD_MM / SIZE
    radius = np.hypot(x[:, None], x) / radius_mm
    rim = (radius > 0.75) & (radius < 0.92)
    return 1.0 - image[radius < 0.3].mean() / image[rim].mean(), image[radius < 0.92].mean()


@pytest.fixture(scope="module")
def calibration():
    return calibrated(BEAM)


@pytest.fixture(scope="module")
def log():
    return disc(140.0, BEAM, 4)


@pytest.mark.slow
def test_cells_that_are_left_out_of_a_calibration_have_no_part_in_its_hardening(calibration):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=24, physics=BEAM, seed=3)
    lines = scan.line_integrals.copy()
    lines[..., 130] *= 3.0
    faulty = sawmill.Scan.from_arrays(lines, scan.angles_rad, SCANNER, from_counts=True)
    found = sawmill.calibrate(faulty, "l-shape").result.beam_hardening
    # With that cell's samples it would be 14 % more.
    assert found.spread == pytest.approx(calibration.result.beam_hardening.spread, rel=0.01)


@pytest.mark.slow
def test_a_disc_is_flat_with_the_hardening_taken_out_and_darker_in_the_middle_without(calibration, log):
    assert calibration.result.beam_hardening.from_counts
    straight = sawmill.reconstruct(log, calibration, **ASKED)
    bent = sawmill.reconstruct(log, calibration, hardening="none", **ASKED)
    assert cupping_and_level(bent.image, 140.0)[0] > 0.05
    # Of which views and photons are 1 %.
    assert abs(cupping_and_level(straight.image, 140.0)[0]) < 0.02
    (done,) = set(straight.result.preparation) - set(bent.result.preparation)
    assert done.startswith("beam hardening of -")
    assert done.endswith("was taken out")


@pytest.mark.slow
def test_a_log_whose_middle_row_shows_nothing_is_reconstructed(calibration, log):
    row = log.line_integrals
    stack = np.concatenate([row, np.zeros_like(row), row], axis=1)
    rows = sawmill.Scan.from_arrays(stack, log.angles_rad, SCANNER, from_counts=True)
    found = sawmill.reconstruct(rows, calibration, method="fbp", **ASKED)
    assert "beam hardening, as the calibration found it, was taken out" in found.result.preparation
    np.testing.assert_array_equal(found.volume[0], sawmill.reconstruct(log, calibration, method="fbp", **ASKED).image)


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("beam", "share"),
    [
        ({"scatter_share": 0.04, "energy_spread": 0.5}, 0.04),
        pytest.param({"scatter_share": 0.04}, 0.04, marks=pytest.mark.nightly),
        pytest.param({"scatter_share": 0.04, "scatter_width_mm": 300.0}, 0.04, marks=pytest.mark.nightly),
        pytest.param({"scatter_share": 0.01}, 0.01, marks=pytest.mark.nightly),
    ],
    ids=["scatter and hardening", "scatter", "a wider halo", "little scatter"],
)
def test_a_log_is_flat_and_as_dense_as_it_is(beam, share):
    """The parts that remain are below a third: what the calibration's halo and three energies leave is a tenth."""
    calibration = calibrated({"beam": beam})
    scatter, hardening = calibration.result.scattered_radiation, calibration.result.beam_hardening
    assert scatter.around + scatter.wide == pytest.approx(share, rel=0.1)
    assert (hardening is not None and hardening.spread > 0.1) == ("energy_spread" in beam)
    log = disc(90.0, {"beam": beam}, 40)
    corrected = sawmill.reconstruct(log, calibration, **ASKED)
    as_it_is = sawmill.reconstruct(log, calibration, hardening="none", **ASKED)
    (before, low), (after, level) = (cupping_and_level(made.image, 90.0) for made in (as_it_is, corrected))
    assert before > 0.05
    assert abs(after) < before / 3.0
    assert abs(level / ATTENUATION - 1.0) < abs(low / ATTENUATION - 1.0) / 3.0
    done = set(corrected.result.preparation) - set(as_it_is.result.preparation)
    assert any(sentence.startswith("scattered radiation of") for sentence in done)


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("glare", [0.02, 0.05])
def test_glare_is_not_taken_for_scatter(glare):
    """Scatter comes of what the object takes out of the beam, glare of what it leaves."""
    calibration = calibrated({"detector": {"glare_share": glare}})
    assert any("Scattered radiation" in each for each in calibration.result.adjustments)
    assert calibration.result.scattered_radiation is None


def test_the_correction_is_undone_by_its_inverse():
    """Within a thousandth of a line integral, far below the noise of any scan."""
    scatter = ScatteredRadiation(0.05, 0.03, 45)
    primary = np.zeros((3, 300))
    primary[:, 80:220] = 2.5 * np.sqrt(1.0 - np.linspace(-1.0, 1.0, 140) ** 2)
    measured = with_scatter(scatter, primary)
    assert (primary - measured).max() > 0.5
    np.testing.assert_allclose(without_scatter(scatter, measured), primary, atol=1e-3)


def test_noise_in_deep_shadows_grows_by_a_bounded_factor():
    scatter = ScatteredRadiation(0.05, 0.03, 45)
    measured = np.full((1, 300), 7.0)
    measured[:, ::2] = 8.0
    straight = without_scatter(scatter, measured)
    assert np.isfinite(straight).all()
    assert np.ptp(straight) == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(straight - measured, np.log(5.0), atol=1e-3)
