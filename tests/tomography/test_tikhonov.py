import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.tikhonov import tikhonov
from sawmill_vocabulary import AlphaRule

LOG = Phantom("log", (Disc((10.0, 0.0), 120.0, 0.018), Disc((30.0, 40.0), 25.0, 0.01)))


@pytest.fixture
def projector(irregular_turn):
    def make(size, views):
        cells = 3 * size
        geometry = FanBeamGeometry(
            Scanner(860.0, cells, 1000.0 / cells), Theta(2.1, 650.0, -120.0, 30.0, -0.2), irregular_turn(views, 1201)
        )
        return Projector(geometry, ImageGrid(size, 400.0))

    return make


def dense(projector):
    n = projector.grid.size
    units = np.eye(n * n, dtype=np.float32).reshape(-1, n, n)
    return projector.forward(units).reshape(n * n, -1).T.astype(np.float64)


@pytest.mark.parametrize(("views", "noise"), [(20, 0.005), (60, 0.02)])
def test_the_default_weight_is_near_the_best(projector, views, noise):
    """Within 5 % of the least error of five weights around it, the next of which are off by a factor of three."""
    a = projector(48, views)
    sinogram, truth = simulate_sinogram(LOG, a.geometry, noise=noise, seed=1207), LOG.rasterise(48, 400.0)
    found = tikhonov(a, sinogram)
    weights = found.parameters["alpha"][0] * np.geomspace(0.1, 10.0, 5)
    least = min(relative_error(tikhonov(a, sinogram, weight=weight).image, truth) for weight in weights)
    assert relative_error(found.image, truth) < 1.05 * least


def test_cross_validation_needs_a_view_to_leave_out_and_a_weight_is_positive(projector):
    a = projector(16, 1)
    sinogram = simulate_sinogram(LOG, a.geometry, noise=0.02, seed=1208)
    with pytest.raises(GeometryError, match="there is one only: give alpha"):
        tikhonov(a, sinogram)
    assert tikhonov(a, sinogram, rule=AlphaRule.GCV).image.any()
    with pytest.raises(GeometryError, match=r"alpha must be a positive number of mm\^2, not 0"):
        tikhonov(a, sinogram, weight=0.0)


def test_on_the_published_log_the_error_is_at_most_that_of_filtered_back_projection(
    scanner, theta, full_turn, log_sinogram, log_truth
):
    """From all views, where the two are nearest; at half the cells and pixels."""
    coarse = Scanner(scanner.source_to_cor_mm, 384, 2.0 * scanner.detector_pitch_mm)
    a = Projector(FanBeamGeometry(coarse, theta, full_turn(360)), ImageGrid(128, 400.0))
    lines, truth = log_sinogram.reshape(360, 384, 2).mean(axis=2), log_truth.reshape(128, 2, 128, 2).mean(axis=(1, 3))
    assert relative_error(tikhonov(a, lines).image, truth) < relative_error(fbp(a, lines).image, truth)


@pytest.mark.parametrize("weight", [30.0, 3000.0])
def test_it_solves_the_regularised_normal_equations(projector, weight):
    a = projector(16, 9)
    sinogram = simulate_sinogram(LOG, a.geometry, noise=0.02, seed=1202)
    matrix = dense(a)
    solution = np.linalg.solve(matrix.T @ matrix + weight * np.eye(256), matrix.T @ sinogram.ravel())
    found = tikhonov(a, sinogram, weight=weight, tolerance=1e-5)
    assert found.converged.all()
    slope = matrix.T @ (matrix @ found.image.ravel() - sinogram.ravel()) + weight * found.image.ravel()
    # The tolerance, and what the basis in single precision adds to it ...
    assert np.linalg.norm(slope) < 3e-5 * np.linalg.norm(matrix.T @ sinogram.ravel())
    # ... which the ratio of the largest eigenvalue to the weight magnifies.
    assert relative_error(found.image.ravel(), solution) < 1e-2


def test_the_discrepancy_principle_explains_the_data_to_their_noise(projector):
    a = projector(64, 24)
    found = tikhonov(a, simulate_sinogram(LOG, a.geometry, noise=0.03, seed=1203), rule=AlphaRule.DISCREPANCY)
    # Rays beside the image count in neither; weights are interpolated between 181 candidates.
    assert found.misfit[0] == pytest.approx(1.0, abs=0.01)
    curve = found.curves[0]
    assert (np.diff(curve["residual_norms"]) > 0.0).all()
    assert (np.diff(curve["solution_norms"]) < 0.0).all()
    assert curve["alphas"][0] < found.parameters["alpha"][0] < curve["alphas"][-1]


def test_the_discrepancy_principle_keeps_at_least_cross_validation_s_weight(projector):
    """Noise that is given far too small, as by a wrong geometry: explaining the data to it would ruin the image."""
    a = projector(32, 24)
    sinogram = simulate_sinogram(LOG, a.geometry, noise=0.05, seed=1209)
    by_gcv = tikhonov(a, sinogram, rule=AlphaRule.GCV).parameters["alpha"][0]
    by_discrepancy = tikhonov(a, sinogram, rule=AlphaRule.DISCREPANCY, noise=1e-4).parameters["alpha"][0]
    assert by_discrepancy == pytest.approx(by_gcv, rel=0.1)


def test_cross_validation_finds_what_the_dense_matrix_finds(projector):
    a = projector(16, 12)
    sinogram = simulate_sinogram(LOG, a.geometry, noise=0.05, seed=1204)
    matrix = dense(a)
    crossing = matrix.any(axis=1)
    left, singular, _ = np.linalg.svd(matrix[crossing], full_matrices=False)
    seen, y = left.T @ sinogram.ravel()[crossing], sinogram.ravel()[crossing]
    alphas = singular[0] ** 2 * np.geomspace(1e-8, 10.0, 181)
    kept = singular**2 / (singular**2 + alphas[:, None])
    residual = ((1.0 - kept) ** 2 * seen**2).sum(axis=1) + y @ y - seen @ seen
    best = alphas[np.argmin(residual / (y.size - kept.sum(axis=1)) ** 2)]
    found = tikhonov(a, sinogram, rule=AlphaRule.GCV)
    # The trace comes from one random vector: right to some per cent, and the minimum is flat.
    assert best / 3.0 < found.parameters["alpha"][0] < best * 3.0
    assert "gcv" in found.curves[0]


def test_the_l_curve_bends_between_the_extremes(projector):
    a = projector(32, 40)
    truth = LOG.rasterise(32, 400.0)
    sinogram = simulate_sinogram(LOG, a.geometry, noise=0.05, seed=1205)
    found = tikhonov(a, sinogram, rule=AlphaRule.L_CURVE)
    weights = found.parameters["alpha"][0] * np.array([1e-4, 1e4])
    errors = [relative_error(tikhonov(a, sinogram, weight=weight).image, truth) for weight in weights]
    assert relative_error(found.image, truth) < min(errors)


def test_a_block_has_a_weight_for_each_slice(projector):
    a = projector(32, 16)
    sinograms = np.stack([simulate_sinogram(LOG, a.geometry, noise=noise, seed=1206) for noise in (0.01, 0.05)])
    found = tikhonov(a, sinograms)
    assert found.image.shape == (2, 32, 32)
    first, second = found.parameters["alpha"]
    assert second > first
    assert len(found.curves) == 2


def test_running_out_of_iterations_is_reported(projector):
    a = projector(32, 16)
    found = tikhonov(a, simulate_sinogram(LOG, a.geometry, noise=0.01, seed=1207), weight=1e-3, iterations=5)
    assert not found.converged[0]
    assert "had not converged after 5 iterations" in found.remarks[0]


def test_the_published_log(scanner, theta, full_turn, log_sinogram, log_truth):
    a = Projector(FanBeamGeometry(scanner, theta, full_turn(360)[::18]), ImageGrid(256, 400.0))
    found = tikhonov(a, log_sinogram[::18])
    assert found.converged.all()
    assert relative_error(found.image, log_truth) < 0.26


def test_every_step_is_progress(projector):
    """A step is one of forty of the validation or of some 25 of the solution: nothing is silent for a dozen of them."""
    a, shares = projector(32, 20), [0.0]
    tikhonov(a, simulate_sinogram(LOG, a.geometry, noise=0.02, seed=1207), on_progress=shares.append)
    steps = np.diff(shares[:-1])  # the last says that the slice is done, however soon it converged
    assert (steps >= 0.0).all()
    assert steps.max() < 0.05
