"""Every method of the table gives one Estimate, for a block as for a slice; and the choice of a method."""

import math
import sys

import numpy as np
import pytest

from sawmill_contracts.reconstructions import MethodReport
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.choosing import (
    EXPECTED_ERRORS,
    METHODS,
    PRICE_SECONDS,
    expected_error,
    recommend,
    seconds_a_slice,
    views_of_step,
)
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.method import DirectMethod
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_tomography.reconstruction.total_variation import ring_tv, total_variation
from sawmill_tomography.sinograms.noise import estimated_noise, photon_noise
from sawmill_vocabulary import Preference, ReconstructionMethod

SIZE, SLICES = 24, 3
# 2 % of the lines, about.
NOISE = np.full((1, 1, 1), 0.05)
LOG = Phantom("log", (Disc((5.0, -8.0), 110.0, 0.018), Disc((0.0, 0.0), 60.0, 0.006)))
# The parameters that each method reports.
PARAMETERS = {
    "fbp": set(),
    "tikhonov": {"alpha"},
    "cauchy_map": {"sigma", "beta"},
    "total_variation": {"weight", "ring_weight", "coupling"},
    "ring_tv": {"weight", "ring_weight", "coupling"},
}


@pytest.fixture
def projector(full_turn):
    geometry = FanBeamGeometry(Scanner(860.0, 96, 10.5), Theta(0.7, 700.0, 80.0, 20.0, 0.1), full_turn(20))
    return Projector(geometry, ImageGrid(SIZE, 400.0))


@pytest.fixture
def block(projector):
    slices = [simulate_sinogram(LOG, projector.geometry, noise=0.02, seed=1500 + n) for n in range(SLICES)]
    return projector.block(np.stack(slices))


def check(found, slices, shape, parameters):
    assert (found.image.shape, found.image.dtype) == (shape, np.float32)
    assert found.iterations.shape == found.converged.shape == (slices,)
    assert found.converged.all()
    assert set(found.parameters) == parameters
    assert parameters <= MethodReport.model_fields.keys(), (
        "add the fields to sawmill_contracts/reconstructions.py: MethodReport"
    )
    assert all(values.shape in {(slices,), (1,)} for values in found.parameters.values())


def function_of(name):
    return getattr(sys.modules[METHODS[name].__module__], name)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_a_block_through_the_table(projector, block, name):
    method = METHODS[name]()
    if isinstance(method, DirectMethod):
        found = method.reconstruct(projector, block)
        assert found.misfit is None
    else:
        shares = []
        found = method.reconstruct(projector, block, noise=NOISE, on_progress=shares.append)
        assert shares == sorted(shares)
        assert found.misfit.shape == (SLICES,)
        assert found.noise > 0.0
    check(found, SLICES, (SLICES, SIZE, SIZE), PARAMETERS[name])


@pytest.mark.parametrize("name", METHODS)
def test_a_slice_through_the_function(projector, block, name):
    check(function_of(name)(projector, block[0]), 1, (SIZE, SIZE), PARAMETERS[name])


@pytest.mark.parametrize("name", ["cauchy_map", "total_variation"])
def test_a_method_with_its_choice_made_reconstructs_as_the_function_with_what_was_chosen(projector, block, name):
    def silent(_share):
        """No progress."""

    chosen = METHODS[name]().chosen(projector, block[1], noise=NOISE, on_progress=silent)
    assert not chosen.is_open
    found = chosen.reconstruct(projector, block, noise=NOISE, on_progress=silent)
    # The function chooses from the middle slice too, on the support region of the whole block.
    for parameter, values in function_of(name)(projector, block).parameters.items():
        assert found.parameters[parameter] == pytest.approx(values, rel=0.2)


QUALITY, SPEED = Preference.QUALITY, Preference.SPEED
GRID = ImageGrid(256, 400.0)

ROUND_LOG = Phantom("log", (Disc((10.0, 0.0), 120.0, 0.018),))
SCANNER = Scanner(860.0, 256, 4.0)


def scan(angles, noise):
    geometry = FanBeamGeometry(SCANNER, Theta(0.3, 700.0, 50.0, 10.0, 0.05), angles)
    return geometry, simulate_sinogram(ROUND_LOG, geometry, noise=noise, seed=1301)


@pytest.mark.parametrize(
    ("views", "turn", "noise", "prefer", "method", "reason"),
    [
        (360, TAU, 0.01, QUALITY, ReconstructionMethod.RING_TV, "the lowest expected error within 100 ms"),
        (45, TAU, 0.01, QUALITY, ReconstructionMethod.RING_TV, "ring_tv from 45 views"),
        (360, TAU, 0.06, SPEED, ReconstructionMethod.FBP, "speed was preferred"),
        (89, TAU, 0.01, SPEED, ReconstructionMethod.RING_TV, "the lowest expected error"),
        (200, 0.6 * TAU, 0.01, QUALITY, ReconstructionMethod.RING_TV, "the views are no full turn"),
        (200, 0.6 * TAU, 0.01, SPEED, ReconstructionMethod.RING_TV, "the views are no full turn"),
    ],
)
def test_error_price_and_gaps_decide_and_the_reason_is_given(views, turn, noise, prefer, method, reason):
    chosen = recommend(*scan(np.arange(views) * turn / views, noise), GRID, fitted_size=256, prefer=prefer)
    assert chosen.method is method
    assert reason in chosen.reason
    assert (chosen.expected_error is None) == (turn < TAU)


def test_views_are_left_out_down_to_the_price_and_no_further():
    geometry, sinogram = scan(np.arange(720) * TAU / 720, 0.01)
    chosen = recommend(geometry, sinogram, GRID, fitted_size=256)
    seconds = [
        seconds_a_slice(chosen.method, -(-720 // step), 256, 256) for step in (chosen.view_step, chosen.view_step - 1)
    ]
    assert seconds[0] <= PRICE_SECONDS < seconds[1]
    # Four times the pixels at four times the price: the time of a projection grows with the pixels across alone.
    assert recommend(geometry, sinogram, ImageGrid(512, 400.0), fitted_size=512).view_step < chosen.view_step


def test_a_small_region_of_a_large_log_is_worth_what_the_log_is_worth():
    geometry, sinogram = scan(np.arange(40) * TAU / 40, 0.01)
    of_region = recommend(geometry, sinogram, ImageGrid(16, 4.0), fitted_size=1600)
    assert of_region.method is recommend(geometry, sinogram, ImageGrid(1600, 400.0), fitted_size=1600).method
    assert of_region.method is not ReconstructionMethod.FBP


def test_where_nothing_fits_the_price_the_cheapest_is_taken():
    # Of a few pixels the filter alone, or the projections, cost more than they are worth.
    geometry, sinogram = scan(np.arange(40) * TAU / 40, 0.01)
    chosen = recommend(geometry, sinogram, ImageGrid(4, 4.0), fitted_size=4)
    assert chosen.reason.startswith("nothing costs less than 0.024 ms a slice; the least: ")
    assert chosen.method.value in chosen.reason


def test_left_out_views_are_the_same_whatever_their_order():
    angles = np.arange(12) * TAU / 12
    shuffled = np.random.default_rng(1304).permutation(12)
    assert views_of_step(angles, 3).tolist() == [0, 3, 6, 9]
    np.testing.assert_allclose(np.sort(angles[shuffled][views_of_step(angles[shuffled], 3)]), angles[::3])


def test_expected_errors_are_those_measured_and_lie_between_them():
    for method, rows in EXPECTED_ERRORS.items():
        assert expected_error(method, 20, 0.02) == pytest.approx(rows[1][1])
        assert rows[2][1] < expected_error(method, 30, 0.02) < rows[1][1]
        assert rows[1][1] < expected_error(method, 20, 0.03) < rows[1][2]


@pytest.mark.slow
@pytest.mark.parametrize(("views", "noise"), [(12, 0.02), (20, 0.005), (40, 0.02)])
def test_the_expected_error_is_within_a_fifth_of_the_error_of_a_log(scanner, theta, full_turn, views, noise):
    """The table was not measured with this log."""
    log = LogModel.random(9701, radius_mm=130.0).slice_at(150.0)
    geometry = FanBeamGeometry(scanner, theta, full_turn(views))
    sinogram, grid = simulate_sinogram(log, geometry, noise=noise, seed=9701), ImageGrid(256, 400.0)
    chosen = recommend(geometry, sinogram, grid, fitted_size=grid.size)
    assert chosen.method is ReconstructionMethod.RING_TV
    error = relative_error(ring_tv(Projector(geometry, grid), sinogram).image, log.rasterise(grid.size, grid.field_mm))
    assert error == pytest.approx(chosen.expected_error, rel=0.2)


def test_on_the_published_log_the_choice_beats_filtered_back_projection(
    scanner, theta, full_turn, log_sinogram, log_truth
):
    """At half the pixels and cells total variation leaves half of the error from 90 views."""
    views = 90
    geometry = FanBeamGeometry(
        Scanner(scanner.source_to_cor_mm, 384, 2.0 * scanner.detector_pitch_mm), theta, full_turn(360)[:: 360 // views]
    )
    lines = log_sinogram[:: 360 // views].reshape(views, 384, 2).mean(axis=2)
    grid = ImageGrid(128, 400.0)
    chosen = recommend(geometry, lines, grid, fitted_size=128)
    truth = log_truth.reshape(128, 2, 128, 2).mean(axis=(1, 3))
    used = views_of_step(geometry.angles_rad, chosen.view_step)
    projector = Projector(geometry.with_angles(geometry.angles_rad[used]), grid)
    assert chosen.method in (ReconstructionMethod.TOTAL_VARIATION, ReconstructionMethod.RING_TV)
    direct = relative_error(fbp(Projector(geometry, grid), lines).image, truth)
    assert relative_error(total_variation(projector, lines[used]).image, truth) < 0.65 * direct


def test_noise_is_estimated_with_and_without_air_and_noise_free_data_are_not_trusted_without_limit():
    _, sinogram = scan(np.arange(60) * TAU / 60, 0.02)
    _, clean = scan(np.arange(60) * TAU / 60, 0.0)
    noise = 0.02 * math.sqrt(float(np.mean(clean**2)))
    assert estimated_noise(sinogram.astype(np.float32)) == pytest.approx(noise, rel=0.1)
    inner = np.ascontiguousarray(sinogram[:, 100:156].astype(np.float32))
    # No air there: from second differences, which the log's own curvature raises a little.
    assert estimated_noise(inner) == pytest.approx(noise, rel=0.2)
    assert estimated_noise(clean.astype(np.float32)) == pytest.approx(0.002 * math.sqrt(np.mean(clean**2)), rel=1e-3)


def test_photon_noise_is_the_scatter_of_poisson_counts():
    scatter = float(np.std(-np.log(np.random.default_rng(1302).poisson(5000.0 * math.exp(-2.0), 200_000) / 5000.0)))
    # The delta method, at 677 counts, is right to a part in 1000; the sample's own scatter is 0.2 %.
    np.testing.assert_allclose(photon_noise(np.full((2, 30), 2.0), 5000.0), scatter, rtol=0.01)


@pytest.fixture
def random_image():
    return np.random.default_rng(801).uniform(0.0, 1.0, (64, 64))


def test_the_relative_error_is_the_ratio_of_norms_and_a_perfect_image_has_none(random_image):
    assert relative_error(np.zeros_like(random_image), random_image) == pytest.approx(1.0)
    assert relative_error(1.1 * random_image, random_image) == pytest.approx(0.1)
    assert relative_error([[3.0, 0.0]], [[0.0, 4.0]]) == pytest.approx(1.25)
    assert relative_error(random_image, random_image) == 0.0
    assert structural_similarity_index(random_image, random_image) == pytest.approx(1.0, abs=1e-12)


def test_neither_depends_on_the_unit_and_more_noise_is_less_similar(random_image):
    image = random_image + 0.1 * np.random.default_rng(802).standard_normal(random_image.shape)
    assert relative_error(50.0 * image, 50.0 * random_image) == pytest.approx(relative_error(image, random_image))
    assert structural_similarity_index(50.0 * image, 50.0 * random_image) == pytest.approx(
        structural_similarity_index(image, random_image)
    )
    noise = np.random.default_rng(803).standard_normal(random_image.shape)
    values = [structural_similarity_index(random_image + level * noise, random_image) for level in (0.05, 0.2, 0.8)]
    assert values[0] > values[1] > values[2]
