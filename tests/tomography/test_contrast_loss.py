"""What a geometry error costs: against images of disturbed scans, closed forms, and the bound against its own draws."""

import math

import numpy as np
import pytest
from contrast_loss import LEAST, SCANNERS, compared

from sawmill_tomography.geometry.contrast_loss import contrast_loss, contrast_loss_bound
from sawmill_tomography.geometry.geometry import Scanner, SourceFrame
from sawmill_tomography.geometry.ray_error import predicted_ray_error

SCANNER, FRAME = Scanner(859.46, 768, 1.5), SourceFrame(0.3, 880.0, 1600.0, 0.0, 0.0)


def loss(psi=0.0, r=0.0, sdd=0.0, u_c=0.0, tau=0.0, *, radius_mm=120.0):
    return contrast_loss(SCANNER, FRAME, np.array([psi, r, sdd, u_c, tau]), radius_mm=radius_mm)


@pytest.mark.slow
def test_images_of_disturbed_scans_lose_what_is_predicted():
    """Within 10 %, as the issue of the formula asked; 50 scans of each scanner differ by 7 % at most."""
    seen, predicted, _ = compared(SCANNERS["modules"], 6, 5610)
    large = seen > LEAST
    assert large.sum(axis=0).min() >= 1
    np.testing.assert_allclose(predicted[large], seen[large], rtol=0.1)


def test_a_detector_that_slid_doubles_edges_at_the_centre_as_opposite_rays_say():
    """Both opposite rays of a place near the COR are displaced by u_c over the magnification, away from each other."""
    for u_c in (0.5, 2.0):
        expected = 100.0 * (1.0 - math.cos(2.0 * math.pi * 0.1 * u_c / FRAME.magnification))
        assert loss(u_c=u_c, radius_mm=5.0).mtf_percent == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("error", [{"psi": 0.1}, {"r": 20.0}])
def test_a_turn_and_a_common_scale_cost_nothing(error):
    assert loss(**error).mtf_percent == pytest.approx(0.0, abs=1e-3)
    assert not loss(**error).matters


def test_losses_grow_with_the_error_up_to_all():
    knots = [loss(u_c=u_c).knot_10_mm_percent for u_c in (0.5, 1.0, 2.0, 4.0, 60.0)]
    assert knots == sorted(knots)
    assert (loss(u_c=1.0).matters, loss(u_c=2.0).matters) == (False, True)
    assert loss(u_c=60.0).knot_10_mm_percent == pytest.approx(100.0, abs=1.0)


def test_nineteen_of_twenty_errors_cost_less_than_the_bound():
    """300 draws: a share of 5 % is known to 1.3 %. Twice the bound of the rays has nearly four times the loss."""
    covariance = np.diag(np.square([0.01, 5.0, 20.0, 0.5, 0.01]))
    upper_mm = predicted_ray_error(SCANNER, FRAME, covariance, radius_mm=120.0).upper_95_mm
    once, twice = (
        contrast_loss_bound(SCANNER, FRAME, covariance, times * upper_mm, radius_mm=120.0) for times in (1.0, 2.0)
    )
    rng = np.random.default_rng(5620)
    drawn = [loss(*error) for error in rng.multivariate_normal(np.zeros(5), covariance, size=300)]
    assert np.mean([each.mtf_percent > once.mtf_percent for each in drawn]) == pytest.approx(0.05, abs=0.03)
    assert 3.5 < twice.knot_10_mm_percent / once.knot_10_mm_percent < 4.0
