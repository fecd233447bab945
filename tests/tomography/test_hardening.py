"""Beam hardening: fitted to known paths, and taken out of line integrals."""

import numpy as np
import pytest

from sawmill_tomography.sinograms.noise import noise_of_rays
from sawmill_tomography.sinograms.scattered_radiation import fit_hardening, measured_and_slope, straightened
from sawmill_vocabulary.scattered_radiation import BeamCorrection, BeamHardening

HARDENING = BeamHardening(spread=0.4, longest=2.0, from_counts=True)


def three_energies(p, spread):
    """As `sawmill simulate --physics` has them."""
    return -np.log(sum(w * np.exp(-a * p) for w, a in ((0.3, 1.0 + spread), (0.4, 1.0), (0.3, 1.0 - spread))))


@pytest.mark.parametrize("spread", [0.15, 0.3, 0.45])
def test_line_integrals_of_three_energies_become_straight_beyond_the_phantom_s_longest_path_too(spread):
    """Within 1 % in the phantom's range and 2 % to 1.5 times its longest path, where the scan itself bends by 16 %."""
    lengths = np.linspace(0.0, 150.0, 1500).reshape(3, 500)
    found = fit_hardening(lengths, 0.01 + three_energies(0.02 * lengths, spread), from_counts=True)
    p = np.linspace(0.3, 4.5, 100)
    straight = straightened(found, three_energies(p, spread)) / p
    assert np.ptp(straight[p < 3.0]) < 0.01
    assert np.ptp(straight) < 0.02
    assert found.longest == pytest.approx(three_energies(np.array(3.0), spread), rel=0.01)


def test_the_correction_is_undone_by_its_inverse_and_a_beam_that_does_not_harden_has_none():
    measured = np.linspace(-0.5, 8.0, 400)
    straight = straightened(HARDENING, measured).astype(np.float64)
    back, slope = measured_and_slope(HARDENING, straight)
    inside = measured > 0.0
    np.testing.assert_allclose(back[inside], measured[inside], atol=1e-5)
    # Centred differences of single precision, away from the kink.
    np.testing.assert_allclose(slope[inside], np.gradient(straight, measured)[inside], rtol=0.02)
    lengths = np.linspace(0.0, 150.0, 1500).reshape(3, 500)
    assert fit_hardening(lengths, 0.01 + 0.02 * lengths, from_counts=True) is None
    assert fit_hardening(lengths, 0.01 + 0.02 * lengths + 1e-5 * lengths**2, from_counts=True) is None


def test_noise_grows_by_a_bounded_factor():
    """A ray through metal is not spread over the image."""
    assert np.diff(straightened(HARDENING, np.array([50.0, 51.0])))[0] == pytest.approx(5.0, rel=1e-4)


def test_rays_are_noisier_by_the_slope_of_the_correction():
    rng = np.random.default_rng(4)
    measured = np.zeros((20, 200), np.float32)
    measured[:, 60:140] = 1.5
    measured += 0.01 * rng.standard_normal(measured.shape).astype(np.float32)
    lines = straightened(HARDENING, measured)[None]
    noise = noise_of_rays(lines, counts=False, beam=BeamCorrection(HARDENING))
    # The scatter of 1 600 samples is known to 2 %.
    assert noise[0, 0, 10] == pytest.approx(0.01, rel=0.1)
    assert noise[0, 0, 100] / noise[0, 0, 10] == pytest.approx(np.exp(0.4 * 1.5), rel=0.02)
    of_counts = noise_of_rays(lines, counts=True, beam=BeamCorrection(HARDENING))
    assert of_counts[0, 0, 100] / of_counts[0, 0, 10] == pytest.approx(np.exp((0.4 + 0.5) * 1.5), rel=0.02)
