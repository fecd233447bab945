import numpy as np
import pytest

from sawmill_tomography.calibration.fit import refine
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import BUILT_IN, L_SHAPE
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells


@pytest.fixture
def cells(scanner):
    return DetectorCells.of(scanner)


@pytest.fixture
def true(theta, scanner):
    return theta.source_frame(scanner.source_to_cor_mm)


@pytest.mark.parametrize("phantom", BUILT_IN.values(), ids=BUILT_IN)
def test_exact_data_are_fitted_exactly(scanner, cells, true, irregular_turn, phantom):
    angles = irregular_turn(25, 1301)
    sinogram = 3.0 * analytic.project(phantom, cells, true, angles, position_mm=(4.0, -3.0)) + 7.0
    start = SourceFrame.from_vector(to_vector(true) + np.array([0.05, 15.0, -20.0, 10.0, 0.05]))
    fit = refine(phantom, SinogramData(sinogram, angles, cells), start)
    assert fit.converged
    # What is left is the stop: a step that gains less than 1e-14 of the power.
    assert ray_error(scanner, true, fit.frame).rms_mm < 1e-4
    np.testing.assert_allclose(fit.position_mm, (4.0, -3.0), atol=1e-4)
    assert fit.gain == pytest.approx(3.0, rel=1e-6)
    assert fit.offset == pytest.approx(7.0, abs=1e-3)
    assert fit.relative_residual < 1e-5


def test_a_fixed_source_distance_stays_and_has_no_variance(cells, true, full_turn):
    sinogram = analytic.project(L_SHAPE, cells, true, full_turn(20))
    start = SourceFrame.from_vector(to_vector(true) * [1.0, 1.01, 1.01, 1.0, 1.0])
    fit = refine(L_SHAPE, SinogramData(sinogram, full_turn(20), cells), start, fixed_source_distance=True)
    assert fit.frame.source_distance_mm == start.source_distance_mm
    assert fit.covariance.held == {FitParameter.R}
    assert fit.covariance.unknown == frozenset()
    assert not fit.covariance.values[1].any()
    assert not fit.covariance.values[:, 1].any()
    assert (np.diag(fit.covariance.values)[fit.covariance.determined] > 0.0).all()
    assert [int(p) for p in fit.covariance.determined] == [0, 2, 3, 4, 5, 6]


def test_the_covariance_is_that_of_least_squares(cells, true, full_turn):
    """Against the textbook: noise variance times the inverse of J'J, gain and offset among the unknowns."""
    angles = full_turn(12)
    clean = analytic.project(L_SHAPE, cells, true, angles)
    data = clean + np.random.default_rng(1302).normal(0.0, 2.0, clean.shape)
    fit = refine(L_SHAPE, SinogramData(data, angles, cells), true)
    rows = analytic.project(L_SHAPE, cells, fit.frame, angles, position_mm=fit.position_mm, derivatives=True)
    slopes, model = rows[:7], rows[7]
    columns = np.stack([*(fit.gain * slope.ravel() for slope in slopes), model.ravel(), np.ones(model.size)], -1)
    variance = float(((data - fit.gain * model - fit.offset) ** 2).sum()) / (data.size - 9)
    scale = 1.0 / np.linalg.norm(columns, axis=0)
    unit = np.linalg.inv((columns * scale).T @ (columns * scale))
    expected = variance * (unit * np.outer(scale, scale))[:7, :7]
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(fit.covariance.values / size, expected / size, atol=1e-3)


@pytest.mark.parametrize(
    "change",
    [[0, 0, 0, 5000.0, 0], [0, -800.0, 0, 0, 0], [0, 0, -900.0, 0, 0], [0, 0, 0, 0, 1.5]],
    ids=["no shadow", "the source in the phantom", "the detector before the centre", "the detector along the ray"],
)
def test_a_start_that_explains_nothing_has_no_fit(cells, true, full_turn, change):
    sinogram = analytic.project(L_SHAPE, cells, true, full_turn(10))
    start = SourceFrame.from_vector(to_vector(true) + change)
    assert refine(L_SHAPE, SinogramData(sinogram, full_turn(10), cells), start) is None
