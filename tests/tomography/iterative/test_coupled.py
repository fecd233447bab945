"""Slices that help their neighbours: the objective's laws, and what is gained; candidates by the views left out."""

from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, GeometryError, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.iterative.coupled import CoupledObjective
from sawmill_tomography.reconstruction.iterative.cross_validation import FOLDS, cross_validate, first_images_of_folds
from sawmill_tomography.reconstruction.iterative.penalised import Objective
from sawmill_tomography.reconstruction.iterative.priors import TotalVariationPrior
from sawmill_tomography.reconstruction.total_variation import TotalVariation, total_variation
from sawmill_tomography.reconstruction.total_variation_weights import CouplingChoice, choose_coupling

SIZE, SLICES = 48, 6


def log(number):
    """A core that wanders slowly along the axis."""
    return Phantom("log", (Disc((5.0, -8.0), 120.0, 0.018), Disc((0.0, 2.0 * number), 40.0, 0.006)))


@pytest.fixture(scope="module")
def projector():
    angles = (np.arange(20) + 0.3) * 2.0 * np.pi / 20
    geometry = FanBeamGeometry(Scanner(860.0, 144, 5.6), Theta(0.7, 700.0, 50.0, 10.0, 0.05), angles)
    return Projector(geometry, ImageGrid(SIZE, 300.0))


@pytest.fixture(scope="module")
def lines(projector):
    found = [simulate_sinogram(log(n), projector.geometry, noise=0.04, seed=2500 + n) for n in range(SLICES)]
    return projector.block(np.stack(found))


def test_the_gradient_is_that_of_the_value(projector, lines):
    prior = TotalVariationPrior(np.full(SLICES, 4e-4), np.full(SLICES, 300.0), np.full(SLICES, 0.02))
    weights = np.full((1, 1, 1), 100.0, np.float32) * np.ones_like(lines)
    objective = CoupledObjective(Objective(projector, lines, weights, prior), np.array([0.5, 0.0, 0.5, 1.0, 0.5]))
    rng = np.random.default_rng(2510)
    here = (0.018 * rng.random((1, SLICES, SIZE, SIZE))).astype(np.float32)
    way = (1e-3 * rng.standard_normal(here.shape)).astype(np.float32)
    which = np.arange(1)
    (before,), _ = objective(here - way, which)
    (after,), _ = objective(here + way, which)
    _, gradient = objective(here, which)
    assert float(np.vdot(gradient.astype(float), way)) == pytest.approx(0.5 * (after - before), rel=2e-3)
    # Slices that are no neighbours do not matter to each other.
    other = here.copy()
    other[0, 2] += 0.01
    _, moved = objective(other, which)
    np.testing.assert_array_equal(moved[0, :2], gradient[0, :2])
    assert np.abs(moved[0, 3] - gradient[0, 3]).max() > 0.0


def test_neighbours_lower_the_error_and_the_data_choose_to_let_them(projector, lines):
    truth = np.stack([log(n).rasterise(SIZE, 300.0) for n in range(SLICES)])
    alone = total_variation(projector, lines, weight=200.0)
    found = choose_coupling(projector, lines, 200.0)
    assert found.coupling > 0.0
    assert found.weight < 200.0
    coupled = total_variation(projector, lines, weight=found.weight, coupling=found.coupling)
    errors = [np.linalg.norm(image - truth) for image in (coupled.image, alone.image)]
    assert errors[0] < 0.93 * errors[1]
    assert alone.parameters["coupling"].tolist() == [0.0]
    assert coupled.parameters["coupling"].tolist() == [found.coupling]


def test_slices_that_have_nothing_in_common_are_left_alone(projector):
    discs = [Disc((70.0 * np.cos(2.4 * n), 70.0 * np.sin(2.4 * n)), 25.0, 0.03) for n in range(5)]
    bodies = [Phantom("disc", (disc,)) for disc in discs]
    geometry = projector.geometry
    rows = [simulate_sinogram(body, geometry, noise=0.01, seed=2520 + n) for n, body in enumerate(bodies)]
    assert choose_coupling(projector, projector.block(np.stack(rows)), 100.0).coupling == 0.0


def test_a_weight_that_stays_is_that_of_the_choice(projector, lines):
    reported = []
    found = choose_coupling(projector, lines, 200.0, weight_stays=True, on_progress=reported.append)
    assert found.coupling > 0.0
    assert found.weight == 200.0
    assert len(reported) > 20
    assert reported == sorted(reported)
    assert reported[-1] <= 1.0


def test_a_weight_chosen_without_neighbours_falls_where_slices_are_coupled(projector, lines):
    """Of 0.4 between neighbours, three quarters of the weight of a slice alone remain."""
    noise = np.full((1, 1), 0.04 * np.sqrt(np.mean(lines**2)))
    alone, coupled = (
        total_variation(projector, lines[:2], coupling=coupling).parameters["weight"] for coupling in (0.0, 0.4)
    )
    np.testing.assert_allclose(coupled, 0.75 * alone, rtol=1e-6)
    chosen = [
        TotalVariation(coupling=coupling).chosen(projector, lines[0], noise=noise, on_progress=lambda _share: None)
        for coupling in ("none", "0.4")
    ]
    assert chosen[1].weight == pytest.approx(0.75 * chosen[0].weight)


def test_slices_beside_a_gap_are_not_coupled_across_it(projector, lines):
    method = TotalVariation(weight=200.0, coupling="0.5")
    settings = {"noise": np.full((1, 1, 1), 0.05), "on_progress": lambda _share: None}
    found = method.reconstruct(projector, lines[:4], numbers=np.array([3, 4, 7, 8]), **settings)
    apart = total_variation(projector, lines[:4], weight=200.0, noise=0.05, coupling=[0.5, 0.0, 0.5])
    np.testing.assert_array_equal(found.image, apart.image)
    joined = method.reconstruct(projector, lines[:4], numbers=np.arange(4), **settings)
    assert np.abs(joined.image - found.image).max() > 0.0


def test_slices_apart_and_one_alone_have_nothing_to_couple(projector, lines):
    assert choose_coupling(projector, lines[:3], 200.0, numbers=np.array([0, 2, 7])) == CouplingChoice(0.0, 200.0)
    assert choose_coupling(projector, lines[:1], 200.0) == CouplingChoice(0.0, 200.0)
    coupled, alone = (total_variation(projector, lines[:1], weight=200.0, **each) for each in ({"coupling": 0.5}, {}))
    np.testing.assert_array_equal(coupled.image, alone.image)


def test_a_coupling_is_0_or_positive_and_one_for_each_pair_of_neighbours(projector, lines):
    with pytest.raises(GeometryError, match=r"coupling must be 0 or a positive number, not -0\.5"):
        total_variation(projector, lines, weight=200.0, coupling=-0.5)
    with pytest.raises(GeometryError, match=r"one number, or 5 of them for 6 slices, not of shape \(6,\)"):
        total_variation(projector, lines, weight=200.0, coupling=np.full(SLICES, 0.5))


SMALL, NOISE = 32, 0.05
BLOCKY = Phantom("log", (Disc((0.0, 10.0), 130.0, 0.015), Disc((20.0, -10.0), 50.0, 0.006)))
# The data weigh as much as they should, and hardly at all.
STRENGTHS = np.array([30.0, 1e5])


def projector_of(views, irregular_turn):
    geometry = FanBeamGeometry(
        Scanner(860.0, 96, 10.5), Theta(0.4, 700.0, 80.0, 20.0, 0.1), irregular_turn(views, 1401)
    )
    return Projector(geometry, ImageGrid(SMALL, 400.0))


def objective_of(projector):
    noise = NOISE * np.random.default_rng(1402).standard_normal(projector.geometry.sinogram_shape)
    lines = (projector.forward(BLOCKY.rasterise(SMALL, 400.0)) + noise).astype(np.float32)[None]
    weights = np.full(lines.shape, 1.0 / NOISE**2, np.float32)
    scale = np.full(STRENGTHS.size, 3e-4)
    return Objective(projector, lines, weights, TotalVariationPrior(scale, STRENGTHS, scale))


def validated(objective, starts, iterations=15):
    noise = np.full((1, 1), NOISE)
    return cross_validate(objective, noise, starts, exponent=1.0, iterations=iterations, non_negative=True)


def starts_of(objective):
    return first_images_of_folds(objective.only(0), np.zeros((SMALL, SMALL), np.float32), non_negative=True)


@pytest.mark.slow
def test_the_candidate_that_explains_the_scan_predicts_views_and_rays_better(irregular_turn):
    objective = objective_of(projector_of(23, irregular_turn))
    found = validated(objective, starts_of(objective))
    assert found.images.shape == (FOLDS, 2, SMALL, SMALL)
    assert found.in_views[0] < 0.8 * found.in_views[1]
    assert found.in_rays[0] < 0.5 * found.in_rays[1]
    # Noise alone would give 1; 23 views of a blocky log with some noise left in it, somewhat more.
    assert 0.9 < found.in_rays[0] < 2.0


@pytest.mark.slow
def test_each_fold_is_independent_of_its_validation_views(irregular_turn):
    views = 6
    objective = objective_of(projector_of(views, irregular_turn))
    starts = starts_of(objective)
    plain = validated(objective, starts, iterations=1).images
    unmoved = np.zeros((views, FOLDS), int)
    for view in range(views):
        lines = objective.lines.copy()
        lines[:, view] = 0.0
        other = validated(replace(objective, lines=lines), starts, iterations=1).images
        unmoved[view] = np.isclose(other, plain).all(axis=(1, 2, 3))
    # Every view is left out of one fold.
    np.testing.assert_array_equal(unmoved.sum(axis=1), 1)
    # One of each five neighbours.
    np.testing.assert_array_equal(unmoved[:FOLDS].sum(axis=0), 1)


@pytest.mark.slow
@pytest.mark.parametrize("views", [1, 2, 4])
def test_few_views_are_left_out_one_by_one_and_a_single_one_is_not(views, irregular_turn):
    objective = objective_of(projector_of(views, irregular_turn))
    found = validated(objective, starts_of(objective))
    assert len(found.images) == views
    if views == 1:
        np.testing.assert_array_equal(found.in_views, 1.0)
    assert np.isfinite(found.in_views).all()
    assert np.isfinite(found.in_rays).all()
