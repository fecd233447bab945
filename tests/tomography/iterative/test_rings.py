"""Ring-aware total variation: the prior's laws, the pith, and what the choice takes on wood and on bodies without."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.iterative.priors import RingPrior, TotalVariationPrior
from sawmill_tomography.reconstruction.iterative.ring_directions import edge_directions, ring_directions
from sawmill_tomography.reconstruction.knot_contrast import knot_contrasts
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import RingTotalVariation, TotalVariation, total_variation
from sawmill_tomography.reconstruction.total_variation_weights import choose_ring_weight

SIZE, FIELD_MM = 128, 200.0
GRID = ImageGrid(SIZE, FIELD_MM)
WOOD = 0.015


def projector_of(views, full_turn):
    geometry = FanBeamGeometry(Scanner(860.0, 256, 2.4), Theta(0.7, 700.0, 50.0, 10.0, 0.05), full_turn(views))
    return Projector(geometry, GRID)


def eccentric_rings(pith_mm, radius_mm=90.0, rings=18):
    """Rings of 5 mm whose centres go from the middle of the outline to the pith."""
    shares = np.linspace(1.0, 1.0 / rings, rings)
    densities = [WOOD, *((-1) ** n * 0.003 for n in range(1, len(shares)))]
    places = [((1.0 - s) * pith_mm[0], (1.0 - s) * pith_mm[1]) for s in shares]
    return Phantom("rings", tuple(map(Disc, places, radius_mm * np.asarray(shares), densities)))


def board(half_width_mm, half_height_mm, x=3.0, y=-4.0):
    corners = [(x + a * half_width_mm, y + b * half_height_mm) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return Phantom("board", (Polygon(tuple(corners), WOOD),))


def random_prior(rng, share):
    r = rng.standard_normal((1, 2, 24, 24))
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    one = np.ones(2)
    return RingPrior(2e-3 * one, 5.0 * one, WOOD * one, np.array(share), r.astype(np.float32))


def test_the_gradient_is_that_of_the_value_and_a_share_of_0_is_total_variation():
    rng = np.random.default_rng(3101)
    prior, which = random_prior(rng, [0.97, 0.0]), np.arange(2)
    here = (WOOD * rng.random((2, 24, 24))).astype(np.float32)
    way = (1e-4 * rng.standard_normal(here.shape)).astype(np.float32)
    values = [prior.add(here + step * way, which, np.zeros_like(here)) for step in (-1.0, 1.0)]
    gradient = np.zeros_like(here)
    value = prior.add(here, which, gradient)
    slopes = np.einsum("bij,bij->b", gradient.astype(float), way)
    np.testing.assert_allclose(slopes, 0.5 * (values[1] - values[0]), rtol=5e-3)
    plain, isotropic = np.zeros_like(here), TotalVariationPrior(prior.scale, prior.strength, prior.corner)
    assert value[1] == pytest.approx(isotropic.add(here, which, plain)[1], rel=1e-5)
    np.testing.assert_allclose(gradient[1], plain[1], rtol=1e-4, atol=1e-4)
    ones = np.ones(2)
    np.testing.assert_allclose(prior.scaling(here, which, ones)[1], isotropic.scaling(here, which, ones)[1], rtol=1e-4)


@pytest.mark.parametrize("pith_mm", [(0.0, 0.0), (25.0, -12.0)])
def test_directions_are_across_the_rings_of_an_eccentric_log(pith_mm):
    image = eccentric_rings(pith_mm).rasterise(SIZE, FIELD_MM).astype(np.float32)[None]
    x, y = ring_directions(image, GRID, np.array([WOOD]), np.zeros(0))[0]
    middles = (np.arange(SIZE) + 0.5) * GRID.pixel_mm - 0.5 * FIELD_MM
    at = np.stack(np.meshgrid(middles, middles, indexing="ij"))
    away, pith = np.hypot(*at), np.array(pith_mm)[:, None, None]
    # Halfway, the centre of the ring is half of the pith's displacement away.
    normal = at - 0.5 * pith
    cosine = np.abs(x * normal[0] + y * normal[1]) / np.hypot(*normal)
    assert np.quantile(cosine[(away > 40.0) & (away < 50.0)], 0.1) > 0.97


@pytest.mark.slow
def test_rings_are_kept_where_total_variation_loses_them(full_turn):
    log, projector = eccentric_rings((12.0, -5.0)), projector_of(24, full_turn)
    lines, truth = simulate_sinogram(log, projector.geometry, noise=0.01, seed=3111), log.rasterise(SIZE, FIELD_MM)
    plain, rings = (total_variation(projector, lines, ring_weight=weight) for weight in (1.0, None))
    assert rings.parameters["ring_weight"][0] < 0.2
    assert relative_error(rings.image, truth) < 0.85 * relative_error(plain.image, truth)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "views", "noise"),
    [
        (Phantom("disc", (Disc((3.0, 5.0), 85.0, WOOD),)), 20, 0.02),
        (board(60.0, 52.5), 20, 0.02),
        # Directions along edges predict these better than total variation does, rings or not.
        (board(70.0, 70.0), 12, 0.005),
        (board(45.0, 45.0), 20, 0.005),
    ],
)
def test_a_body_without_rings_gets_none(body, views, noise, full_turn):
    projector = projector_of(views, full_turn)
    chosen = choose_ring_weight(projector, simulate_sinogram(body, projector.geometry, noise=noise, seed=3120))
    assert chosen.ring_weight == 1.0


@pytest.mark.slow
def test_rings_are_kept_where_directions_along_edges_alone_predict_a_little_better(full_turn):
    log, projector = LogModel.random(3142, radius_mm=90.0).slice_at(5.0), projector_of(20, full_turn)
    lines, truth = simulate_sinogram(log, projector.geometry, noise=0.01, seed=3142), log.rasterise(SIZE, FIELD_MM)
    plain, rings = (total_variation(projector, lines, ring_weight=weight) for weight in (1.0, None))
    assert rings.parameters["ring_weight"][0] < 1.0
    assert relative_error(rings.image, truth) < relative_error(plain.image, truth)


def test_edges_have_directions_without_circles_and_even_wood_has_none():
    image = board(60.0, 52.5).rasterise(SIZE, FIELD_MM).astype(np.float32)[None]
    x, y = edge_directions(image, GRID, np.array([WOOD]))[0]
    middle, at_edge = SIZE // 2, int((60.0 + 3.0 + 0.5 * FIELD_MM) / GRID.pixel_mm)
    assert abs(x[at_edge, middle]) > 0.8
    assert np.hypot(x, y)[middle - 5 : middle + 5, middle - 5 : middle + 5].max() < 0.05


def test_more_views_keep_more_of_a_knots_contrast(full_turn):
    log, kept = LogModel.random(3130, radius_mm=90.0).slice_at(5.0), []
    for views in (12, 60):
        projector = projector_of(views, full_turn)
        lines = projector.sinogram(simulate_sinogram(log, projector.geometry, noise=0.01, seed=3131))
        noise = np.full((1, 1, 1), 0.01 * np.sqrt(np.mean(lines**2)))
        kept.append(knot_contrasts(projector, lines, TotalVariation(weight=8.0 / WOOD, coupling="none"), noise=noise))
    few, many = kept
    assert few[10.0] < 0.5 < few[20.0] < many[20.0] < 1.1
    assert many[10.0] > few[10.0] + 0.2


def test_a_choice_is_taken_up_again_and_an_impossible_weight_is_refused(full_turn):
    method = RingTotalVariation(weight=3.0, ring_weight=0.1, coupling="0.4")
    assert RingTotalVariation().with_choice(method.choice) == method
    assert RingTotalVariation(weight=3.0, coupling="0.4").choice == {}
    with pytest.raises(GeometryError, match="ring_weight must be above 0 and at most 1, not 2"):
        total_variation(projector_of(8, full_turn), np.ones((8, 256)), ring_weight=2.0)
