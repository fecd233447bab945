import numpy as np
import pytest

from sawmill_worker.tomography.cauchy_map import cauchy_map, choose_sigma_and_beta
from sawmill_worker.tomography.fbp import fbp
from sawmill_worker.tomography.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.penalised import InverseCurvature, Objective
from sawmill_worker.tomography.iterative.posterior import posterior_deviation
from sawmill_worker.tomography.iterative.priors import CauchyPrior, TotalVariationPrior
from sawmill_worker.tomography.iterative.support_region import SupportRegion
from sawmill_worker.tomography.noise import photon_noise
from sawmill_worker.tomography.phantom import Disc, Phantom, Polygon
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.tomography.quality import relative_error
from sawmill_worker.tomography.simulate import simulate_sinogram
from sawmill_worker.tomography.tikhonov import tikhonov
from sawmill_worker.tomography.total_variation import total_variation

pytestmark = pytest.mark.slow

LOG = Phantom(
    "log of two zones with a knot",
    (
        Disc((5.0, -8.0), 130.0, 0.018),
        Disc((0.0, 0.0), 80.0, -0.006),
        Polygon(((20.0, -10.0), (110.0, 20.0), (105.0, 50.0), (15.0, 10.0)), 0.008),
    ),
)
SIZE, FIELD_MM = 64, 400.0


@pytest.fixture
def projector(irregular_turn):
    def make(*, views=20, size=SIZE, theta=None):
        theta = theta or Theta(0.7, 700.0, 150.0, 60.0, 0.15)
        return Projector(
            FanBeamGeometry(Scanner(860.0, 3 * size, 1000.0 / (3 * size)), theta, irregular_turn(views, 1101)),
            ImageGrid(size, FIELD_MM),
        )

    return make


@pytest.fixture
def scan():
    def make(projector, *, noise=0.02, seed=1102):
        return simulate_sinogram(LOG, projector.geometry, noise=noise, seed=seed)

    return make


@pytest.mark.parametrize("prior_of", [CauchyPrior, TotalVariationPrior])
def test_the_gradient_is_that_of_finite_differences(projector, prior_of):
    rng = np.random.default_rng(1103)
    a = projector(views=5, size=19)
    lines = rng.uniform(0.0, 5.0, (2, *a.geometry.sinogram_shape)).astype(np.float32)
    weights = rng.uniform(0.1, 1.0, lines.shape).astype(np.float32)
    prior = prior_of(np.array([0.3, 2.0]), np.array([1.5, 0.7]), np.array([0.2, 0.5]))
    objective = Objective(a, lines, weights, prior)
    images = rng.uniform(-1.0, 1.0, (2, 19, 19)).astype(np.float32)
    which = np.arange(2)
    _, gradient = objective(images, which)
    for _ in range(5):
        direction = rng.standard_normal(images.shape).astype(np.float32)
        step = np.float32(2.0**-7)
        ahead, _ = objective(images + step * direction, which)
        behind, _ = objective(images - step * direction, which)
        predicted = np.einsum("sij,sij->s", gradient, direction, dtype=np.float64)
        # The objective's third derivative at this step leaves 1e-4 of the largest slope there could be, rounding less.
        largest = np.linalg.norm(gradient, axis=(1, 2)) * np.linalg.norm(direction, axis=(1, 2))
        assert (np.abs((ahead - behind) / (2.0 * step) - predicted) < 1e-3 * largest).all()


@pytest.mark.parametrize("size", [18, 19])
def test_the_preconditioner_is_symmetric_and_positive(projector, size):
    rng = np.random.default_rng(1106)
    a = projector(views=5, size=size)
    lines = np.zeros((1, *a.geometry.sinogram_shape), np.float32)
    prior = CauchyPrior(np.array([0.1]), np.array([1.5]), np.array([0.1]))
    preconditioner = InverseCurvature(Objective(a, lines, np.full_like(lines, 1e-3), prior))
    which = np.array([0])
    one, other = rng.standard_normal((2, 1, size, size)).astype(np.float32)
    there, back = (
        float(np.vdot(other, preconditioner.smoothed(one, which))),
        float(np.vdot(one, preconditioner.smoothed(other, which))),
    )
    along = float(np.vdot(one, preconditioner.smoothed(one, which)))
    # Single precision of a few hundred terms.
    assert there == pytest.approx(back, abs=1e-5 * along)
    assert along > 0.0
    # A flat image is its own reference; an edge, whose curvature is lost, is softer and goes further.
    edge = np.zeros((1, size, size), np.float32)
    edge[0, size // 2 :] = 1.0
    scaling = preconditioner.scaling(edge, which)[0]
    np.testing.assert_allclose(scaling[2:5, 2:-2], 1.0, rtol=1e-5)
    assert (scaling[size // 2 - 1 : size // 2 + 1, 2:-2] > 1.1).all()


def test_the_support_region_holds_the_log(projector, scan):
    a = projector()
    support = SupportRegion.of(a, a.block(scan(a)))
    assert support.projector.grid.size < SIZE
    truth = LOG.rasterise(SIZE, FIELD_MM)
    part = np.ascontiguousarray(truth[support.part])
    np.testing.assert_array_equal(support.embedded(part[None])[0], truth)
    # Positions that differ by rounding share a ray's length otherwise between two pixels.
    np.testing.assert_allclose(support.projector.forward(part), a.forward(truth), atol=1e-4)


def test_the_support_region_is_the_full_grid_where_a_slice_shows_nothing(projector, scan):
    a = projector()
    lines = a.block(np.stack([scan(a), np.zeros(a.geometry.sinogram_shape)]))
    assert SupportRegion.of(a, lines).projector is a


def test_the_corner_pixel_alone_is_penalised_by_its_own_term():
    prior = CauchyPrior(np.array([0.1]), np.array([1.5]), np.array([0.1]))
    images, gradient = np.zeros((1, 8, 8), np.float32), np.zeros((1, 8, 8), np.float32)
    images[0, -1, -1] = 0.3
    value = prior.add(images, np.array([0]), gradient)
    # No difference reaches it: 3/2 log(1 + 0.3^2 / 0.1^2).
    np.testing.assert_allclose(value, 1.5 * np.log(10.0), rtol=1e-6)
    assert gradient[0, -1, -1] == pytest.approx(1.5 * 2.0 * 0.3 / 0.1, rel=1e-5)
    assert np.count_nonzero(gradient) == 1


def test_from_few_views_it_is_far_better_than_filtered_back_projection(projector, scan):
    a = projector()
    truth = LOG.rasterise(SIZE, FIELD_MM)
    sinogram = scan(a)
    found = cauchy_map(a, sinogram)
    assert relative_error(found.image, truth) < 0.5 * relative_error(fbp(a, sinogram).image, truth)
    assert found.image.min() >= 0.0
    assert found.converged.all()
    # 2 % of the RMS, estimated from the air; the misfit also holds what 64 pixels cannot show.
    rms = np.sqrt(np.mean(simulate_sinogram(LOG, a.geometry, seed=0) ** 2))
    assert found.noise == pytest.approx(0.02 * rms, rel=0.1)
    assert 0.7 < found.misfit[0] < 2.0
    assert found.remarks == ()


def test_sigma_and_beta_are_chosen_near_the_best_that_the_truth_would_choose(projector, scan):
    a = projector()
    truth = LOG.rasterise(SIZE, FIELD_MM)
    sinogram = scan(a)
    found = cauchy_map(a, sinogram)
    sigma, beta = found.parameters["sigma"][0], found.parameters["beta"][0]
    pairs = [(s * sigma, b * beta) for s in (0.6, 1.0, 1.7) for b in (0.4, 0.7, 1.3)]
    errors = [relative_error(cauchy_map(a, sinogram, sigma=s, beta=b).image, truth) for s, b in pairs]
    # What benchmarks/choosing.py finds on most logs, and as much again for 64 pixels.
    assert relative_error(found.image, truth) < 1.06 * min(errors)


def test_the_usual_beta_is_smaller_for_smaller_pixels(projector, scan):
    betas = []
    for size in (64, 256):
        a = projector(size=size)
        betas.append(cauchy_map(a, scan(a), sigma=0.1, iterations=1).parameters["beta"][0])
    # Between the differences of edges, which stay, and those of slopes, which are a quarter.
    assert 1.3 < betas[0] / betas[1] < 3.0


def test_a_given_beta_stays_while_sigma_is_chosen(projector, scan):
    a = projector()
    sinogram = scan(a)
    found = cauchy_map(a, sinogram, beta=0.004)
    assert found.parameters["beta"].tolist() == [0.004]
    choice = choose_sigma_and_beta(a, sinogram, beta=0.004)
    sigma = choice.sigma.factor * found.noise
    assert (choice.beta, sigma) == (0.004, pytest.approx(found.parameters["sigma"][0], rel=1e-6))
    assert relative_error(choice.image, found.image) < 0.1


@pytest.mark.parametrize("slices", [1, 3])
@pytest.mark.parametrize(
    ("method", "options"),
    [
        (cauchy_map, {}),
        (cauchy_map, {"sigma": 0.05, "uncertainty": True}),
        (cauchy_map, {"preset": "paper"}),
        (total_variation, {}),
        (total_variation, {"weight": 300.0}),
        (tikhonov, {}),
    ],
)
def test_progress_is_reported_over_all_the_work(projector, scan, method, options, slices):
    a = projector()
    reported = []
    method(a, np.stack([scan(a, seed=seed) for seed in range(slices)]), **options, on_progress=reported.append)
    assert reported == sorted(reported)
    assert 0.0 < reported[0] < 0.5
    assert reported[-1] == pytest.approx(1.0)
    # A descent that ends sooner than most reports its rest at once; the deviation comes in two parts a slice.
    assert np.diff(reported).max() < 0.6


def test_the_answer_scales_with_the_unit(projector, scan):
    a = projector()
    sinogram = scan(a)
    # A power of two leaves the rounding as it was, which alone moves the chosen sigma by some per cent.
    one, many = cauchy_map(a, sinogram), cauchy_map(a, 1024.0 * sinogram)
    for name in ("sigma", "beta"):
        assert many.parameters[name] == pytest.approx(1024.0 * one.parameters[name], rel=1e-4)
    assert relative_error(many.image / 1024.0, one.image) < 1e-3
    flat, varied = total_variation(a, sinogram), total_variation(a, 1024.0 * sinogram)
    assert varied.parameters["weight"] == pytest.approx(flat.parameters["weight"] / 1024.0, rel=1e-4)


def test_a_block_is_reconstructed_as_its_slices(projector, scan):
    a = projector()
    sinograms = np.stack([scan(a, seed=seed) for seed in (1, 2, 3)])
    settings = {"sigma": 0.05, "beta": 0.002}
    block = cauchy_map(a, sinograms, **settings)
    assert block.image.shape == (3, SIZE, SIZE)
    for image, sinogram, value in zip(block.image, sinograms, block.objective, strict=True):
        alone = cauchy_map(a, sinogram, **settings)
        # Rounding sends the two descents into minima that differ a little.
        assert value == pytest.approx(float(alone.objective[0]), rel=2e-3)
        assert relative_error(image, alone.image) < 0.03


def test_a_tape_s_errors_of_the_geometry_show_as_misfit(projector, scan):
    sinogram = scan(projector())
    wrong = cauchy_map(projector(theta=Theta(0.7, 690.0, 158.0, 50.0, 0.15)), sinogram)
    assert wrong.misfit[0] > 2.5
    assert any("check the geometry" in remark for remark in wrong.remarks)


def test_a_background_is_reported(projector, scan):
    a = projector()
    found = cauchy_map(a, scan(a) + 0.5, sigma=0.05, iterations=20)
    assert any("take the background out first" in remark for remark in found.remarks)


def test_starved_rays_count_less_where_counts_are_known(projector):
    """Photon noise grows with exp(p): weighing the rays by it beats one noise for all.

    The log is made of this grid's own pixels, so that noise is all that the data and the image differ by.
    """
    a = projector()
    truth = LOG.of_density(1.5).rasterise(SIZE, FIELD_MM)
    clean = a.forward(truth)
    counts = np.random.default_rng(1104).poisson(3000.0 * np.exp(-clean)).clip(1)
    sinogram = -np.log(counts / 3000.0)
    weighed = cauchy_map(a, sinogram, noise=photon_noise(sinogram, 3000.0))
    alike = cauchy_map(a, sinogram, noise=float(photon_noise(clean, 3000.0).mean()))
    assert relative_error(weighed.image, truth) < 0.9 * relative_error(alike.image, truth)


def test_the_published_settings_are_taken_together(projector, scan):
    a = projector()
    found = cauchy_map(a, 25.0 * scan(a), preset="paper")
    assert (found.parameters["sigma"][0], found.parameters["beta"][0]) == (0.3, 0.01)
    assert found.iterations[0] <= 150
    assert found.image.min() < 0.0


def test_what_cannot_be_is_refused(projector, scan):
    a = projector()
    with pytest.raises(GeometryError, match="beta must be a positive attenuation, not -1"):
        cauchy_map(a, scan(a), beta=-1.0)
    with pytest.raises(GeometryError, match="the noise must be a positive standard deviation"):
        cauchy_map(a, scan(a), sigma=0.0)
    with pytest.raises(GeometryError, match=r"the noise has shape \(3,\); it must be one number or"):
        cauchy_map(a, scan(a), noise=np.ones(3))
    with pytest.raises(GeometryError, match="no attenuation anywhere"):
        cauchy_map(a, np.full(a.geometry.sinogram_shape, -1.0))
    with pytest.raises(GeometryError, match="weight must be a positive number"):
        total_variation(a, scan(a), weight=0.0)


@pytest.mark.parametrize("method", [tikhonov, cauchy_map, total_variation])
@pytest.mark.parametrize("noise", [None, 0.02])
def test_a_slice_without_anything_is_named(projector, scan, method, noise):
    a = projector(views=9, size=16)
    with pytest.raises(GeometryError, match="slice 1, counted from 0, is 0 in every ray"):
        method(a, np.stack([scan(a), np.zeros(a.geometry.sinogram_shape)]), noise=noise)


def test_total_variation_is_a_yardstick_of_the_same_kind(projector, scan):
    a = projector()
    truth = LOG.rasterise(SIZE, FIELD_MM)
    sinogram = scan(a)
    found = total_variation(a, sinogram)
    assert relative_error(found.image, truth) < 0.5 * relative_error(fbp(a, sinogram).image, truth)
    assert 0.7 < found.misfit[0] < 2.0


@pytest.mark.parametrize("prior_of", [CauchyPrior, TotalVariationPrior])
def test_the_deviation_is_the_diagonal_of_the_inverse_precision(projector, prior_of):
    """Against the dense inverse on 12 x 12 pixels, with its differences written out."""
    n = 12
    a = projector(views=7, size=n)
    rng = np.random.default_rng(1105)
    image = rng.uniform(0.0, 1.0, (n, n)).astype(np.float32)
    image[3, 4:7] = 0.0
    beta, strength, corner = 0.3, 1.5, 0.3
    prior = prior_of(np.array([beta]), np.array([strength]), np.array([corner]))
    weights = rng.uniform(0.5, 2.0, (1, *a.geometry.sinogram_shape)).astype(np.float32) * np.float32(1e-3)
    found = posterior_deviation(a, weights, prior, image[None], non_negative=True, samples=256)[0]

    units = np.eye(n * n, dtype=np.float32).reshape(-1, n, n)
    rays = a.forward(units).reshape(n * n, -1).astype(np.float64)
    precision = (rays * weights.reshape(-1)) @ rays.T
    for i in range(n - 1):
        for j in range(n - 1):
            here, right, below = i * n + j, i * n + j + 1, (i + 1) * n + j
            dx, dy = float(image[i + 1, j] - image[i, j]), float(image[i, j + 1] - image[i, j])
            ratio = 1.0 + (dx * dx + dy * dy) / beta**2
            curvature = (
                2.0 * strength / beta**2 / ratio if prior_of is CauchyPrior else strength / beta / np.sqrt(ratio)
            )
            for other in (right, below):
                d = np.zeros(n * n)
                d[other], d[here] = 1.0, -1.0
                precision += curvature * np.outer(d, d)
    corner_strength = strength if prior_of is CauchyPrior else strength * beta
    precision[-1, -1] += 2.0 * corner_strength / (corner**2 + float(image[-1, -1]) ** 2)
    free = image.ravel() > 0.0
    expected = np.zeros(n * n)
    expected[free] = np.sqrt(np.diag(np.linalg.inv(precision[np.ix_(free, free)])))
    assert (found.ravel()[~free] == 0.0).all()
    # 256 samples leave 4.4 % on each of 141 pixels: three and a half of that, and no bias of the mean.
    relative = found.ravel()[free] / expected[free]
    np.testing.assert_allclose(relative, 1.0, atol=0.16)
    assert relative.mean() == pytest.approx(1.0, abs=0.02)


def test_the_deviation_comes_on_request(projector, scan):
    a = projector()
    found = cauchy_map(a, scan(a), sigma=0.03, beta=0.002, uncertainty=True)
    assert found.standard_deviation.shape == (SIZE, SIZE)
    inside = LOG.rasterise(SIZE, FIELD_MM) > 0.01
    assert (found.standard_deviation[inside] > 0.0).mean() > 0.99
    assert cauchy_map(a, scan(a), sigma=0.03, beta=0.002).standard_deviation is None


@pytest.mark.parametrize(("views", "most"), [(20, 0.145), (45, 0.114)])
def test_the_published_log_with_nothing_given(scanner, theta, full_turn, log_sinogram, log_truth, views, most):
    step = 360 // views
    a = Projector(FanBeamGeometry(scanner, theta, full_turn(360)[::step]), ImageGrid(256, 400.0))
    found = cauchy_map(a, log_sinogram[::step])
    assert relative_error(found.image, log_truth) < most
    # The published noise is 1.58 in every column.
    assert found.noise == pytest.approx(1.58, rel=0.08)
    assert 0.8 < found.misfit[0] < 1.3
