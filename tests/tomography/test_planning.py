import math

import numpy as np
import pytest

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.planning import plan
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, angle_difference, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import Handedness, Rotation

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]

NOISE = 0.02
REPEATS = 16


@pytest.fixture
def fan(scanner, theta, full_turn):
    return lambda views: FanBeamGeometry(scanner, theta, full_turn(views))


@pytest.mark.parametrize(("views", "distance_mm", "column_mm"), [(360, 0.18, 0.005), (20, 0.86, 0.023)])
def test_the_l_shape_s_bound_is_the_one_known_from_elsewhere(fan, views, distance_mm, column_mm):
    """Figures of an independent implementation, which rounds them to one or two digits."""
    deviation = plan(fan(views), L_SHAPE, noise=NOISE).frame_deviation
    assert deviation[1] == pytest.approx(distance_mm, rel=0.15)
    assert deviation[3] == pytest.approx(column_mm, rel=0.15)
    if views == 360:
        assert math.degrees(deviation[4]) == pytest.approx(0.01, rel=0.15)


def test_the_bound_is_the_inverse_of_the_stored_derivatives(fan):
    """The same from the whole Jacobian, gain and background among the unknowns, by plain least squares."""
    geometry = fan(20)
    *slopes, model = project(
        RECTANGLE_WITH_HOLE, DetectorCells.of(geometry.scanner), geometry.frame, geometry.angles_rad, derivatives=True
    )[:8]
    jacobian = np.stack([*slopes, model, np.ones_like(model)], -1).reshape(-1, 9)
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale)) / np.outer(scale, scale)
    planned = plan(geometry, RECTANGLE_WITH_HOLE, noise=NOISE)
    expected = (NOISE * np.sqrt(np.mean(model**2))) ** 2 * inverse[:5, :5]
    assert np.allclose(planned.covariance, expected, rtol=1e-6, atol=1e-12)
    assert np.allclose(planned.frame_deviation[:5], np.sqrt(np.diag(expected)))


@pytest.mark.parametrize("phantom", [L_SHAPE, RECTANGLE_WITH_HOLE], ids=lambda phantom: phantom.name)
def test_calibrations_scatter_as_planned(fan, phantom):
    """The middle of 16 calibrations' squared errors: a bound that is off by a quarter fails."""
    geometry = fan(20)
    planned = plan(geometry, phantom, noise=NOISE)
    errors, distances = [], []
    for seed in range(REPEATS):
        sinogram = simulate_sinogram(phantom, geometry, noise=NOISE, seed=seed)
        senses = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN}
        task = CalibrationTask(geometry.scanner, phantom, sinogram, geometry.angles_rad, **senses)
        found = calibrate(task, seed=seed).frame
        error = to_vector(found) - to_vector(geometry.frame)
        error[0] = angle_difference(found.psi_rad, geometry.frame.psi_rad)
        errors.append(error)
        distances.append(ray_error(geometry.scanner, geometry.frame, found).rms_mm)
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / planned.frame_deviation[:5]
    # The RMS of 16 normal errors lies within 0.66 to 1.34 of their deviation in 95 of 100 cases, each of five here.
    assert np.all((ratio > 0.65) & (ratio < 1.4)), ratio
    whitened = np.mean([error @ np.linalg.solve(planned.covariance, error) for error in errors]) / 5.0
    # A chi-square of 80 degrees of freedom over their number: 1 with a standard deviation of 0.16.
    assert 0.7 < whitened < 1.35
    assert float(np.sqrt(np.mean(np.square(distances)))) == pytest.approx(planned.predicted_ray_error.rms_mm, rel=0.3)
    assert np.mean(np.array(distances) < planned.predicted_ray_error.upper_95_mm) >= 0.85


def test_four_times_the_views_halve_the_errors_and_twice_the_noise_doubles_them(fan):
    base = plan(fan(90), L_SHAPE, noise=NOISE)
    denser, noisier = plan(fan(360), L_SHAPE, noise=NOISE), plan(fan(90), L_SHAPE, noise=2.0 * NOISE)
    assert np.allclose(denser.frame_deviation / base.frame_deviation, 0.5, rtol=0.1)
    assert np.allclose(noisier.frame_deviation / base.frame_deviation, 2.0)
    assert noisier.predicted_ray_error.rms_mm == pytest.approx(2.0 * base.predicted_ray_error.rms_mm)


def test_the_density_of_the_wood_changes_nothing(fan):
    planned, denser = (plan(fan(20), L_SHAPE.of_density(factor), noise=NOISE) for factor in (1.0, 0.013))
    assert np.allclose(planned.covariance, denser.covariance)
    assert denser.noise == pytest.approx(0.013 * planned.noise)


def test_a_larger_tolerance_costs_scale_and_nothing_else(fan):
    rough = Phantom("rough", L_SHAPE.shapes, size_tolerance=0.01)
    fine, coarse = (plan(fan(20), phantom, noise=NOISE) for phantom in (L_SHAPE, rough))
    assert coarse.scale.source_distance_mm == pytest.approx(0.01 * fan(20).frame.source_distance_mm)
    assert coarse.scale.ray_error_mm == pytest.approx(0.01 / 0.0015 * fine.scale.ray_error_mm, rel=0.02)
    assert np.array_equal(fine.covariance, coarse.covariance)
    # 1.96 times 1 %, and the noise of R/SDD beside it.
    assert coarse.scale.percent_95 == pytest.approx(1.96, rel=0.02)
    assert fine.scale.percent_95 > 1.96 * 0.15


@pytest.mark.parametrize("center", [(0.0, 0.0), (40.0, 10.0)])
def test_a_disc_alone_is_refused(fan, center):
    with pytest.raises(PhantomError, match="it looks the same from every side"):
        plan(fan(90), Phantom("disc", (Disc(center, 80.0),)), noise=NOISE)


def test_views_cut_off_are_counted_and_too_few_or_without_a_shadow_refused(fan):
    assert plan(fan(20), L_SHAPE, noise=NOISE).views_cut_off == 0
    assert plan(fan(20), L_SHAPE.scaled(2.0), noise=NOISE).views_cut_off > 10
    with pytest.raises(PhantomError, match="casts no shadow"):
        plan(fan(20).with_angles(np.zeros(3)), L_SHAPE.scaled(0.005).moved(800.0, 0.0), noise=NOISE)
    with pytest.raises(PhantomError, match=r"undetermined: choose a body with less symmetry, or more views of it"):
        plan(fan(1), L_SHAPE, noise=NOISE)


@pytest.mark.parametrize("noise", [0.0, -0.1, math.nan, math.inf])
def test_noise_is_a_positive_share(fan, noise):
    with pytest.raises(GeometryError, match="noise must be a positive fraction"):
        plan(fan(20), L_SHAPE, noise=noise)
