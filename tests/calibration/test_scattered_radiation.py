"""The scatter that a calibration found is taken out of a log's line integrals before its hardening."""

import numpy as np
import pytest

import sawmill_calibration as sawmill
from sawmill_tomography.sinograms.scattered_radiation import with_scatter, without_scatter
from sawmill_vocabulary.scattered_radiation import ScatteredRadiation

SCANNER = sawmill.Scanner(859.46, 256, 4.508593749)
THETA = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
ATTENUATION, RADIUS_MM, FIELD_MM, SIZE = 0.018, 90.0, 400.0, 128
LOG = sawmill.Phantom("log", (sawmill.Disc((0.0, 0.0), RADIUS_MM),))


def calibrated(physics):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=24, physics=physics, seed=3)
    return sawmill.calibrate(scan, "l-shape")


def cupping_and_level(image):
    """How much darker the middle of the disc is than its rim, and its mean."""
    x = (np.arange(SIZE) - 0.5 * (SIZE - 1)) * FIELD_MM / SIZE
    radius = np.hypot(x[:, None], x) / RADIUS_MM
    rim = (radius > 0.75) & (radius < 0.92)
    return 1.0 - image[radius < 0.3].mean() / image[rim].mean(), image[radius < 0.92].mean()


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
    log = sawmill.simulate_phantom_scan(LOG, SCANNER, THETA, views=60, physics={"beam": beam}, seed=40)
    asked = {"field_mm": FIELD_MM, "size": SIZE}
    corrected = sawmill.reconstruct(log, calibration, **asked)
    as_it_is = sawmill.reconstruct(log, calibration, hardening="none", **asked)
    (before, low), (after, level) = cupping_and_level(as_it_is.image), cupping_and_level(corrected.image)
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
