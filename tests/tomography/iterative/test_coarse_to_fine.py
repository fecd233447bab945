"""Descents by way of larger pixels, and of the support region: where they end, and what they save."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.iterative.coarse_to_fine import descend_by_levels, mean_along_rays
from sawmill_tomography.reconstruction.iterative.penalised import Objective, descend
from sawmill_tomography.reconstruction.iterative.priors import TotalVariationPrior
from sawmill_tomography.reconstruction.iterative.support_region import (
    SUPPORT_ITERATION_SHARE,
    SupportRegion,
    descend_from_support,
)
from sawmill_tomography.sinograms.present_rows import bridged_samples

SIZE, SIGMA = 128, 0.05
LOG = Phantom("log with a core", (Disc((5.0, -8.0), 120.0, 0.018), Disc((0.0, 0.0), 40.0, 0.006)))


@pytest.fixture(scope="module")
def objective():
    angles = (np.arange(20) + 0.3) * 2.0 * np.pi / 20
    geometry = FanBeamGeometry(Scanner(860.0, 256, 3.2), Theta(0.7, 700.0, 50.0, 10.0, 0.05), angles)
    projector = Projector(geometry, ImageGrid(SIZE, 300.0))
    lines = projector.block(np.stack([simulate_sinogram(LOG, geometry, noise=0.02, seed=n) for n in (1, 2)]))
    prior = TotalVariationPrior(np.full(2, 4e-4), np.full(2, 300.0), np.full(2, 0.02))
    return Objective(projector, lines, np.full(lines.shape, 1.0 / SIGMA**2, np.float32), prior)


def test_larger_pixels_lead_to_the_same_minimum_in_fewer_iterations(objective):
    settings = {"non_negative": True, "iterations": 200, "tolerance": 1e-4}
    reported = []
    found = descend_by_levels(objective, **settings, usual=20, on_progress=reported.append)
    plain = descend(objective, mean_along_rays(objective.projector, objective.lines), **settings)
    np.testing.assert_allclose(found.values, plain.values, rtol=2e-3)
    assert np.linalg.norm(found.images - plain.images) < 0.02 * np.linalg.norm(plain.images)
    few = settings | {"iterations": 8, "tolerance": 0.0}
    early = descend_by_levels(objective, **few, usual=8)
    straight = descend(objective, mean_along_rays(objective.projector, objective.lines), **few | {"iterations": 12})
    assert (early.values < straight.values).all()
    assert reported == sorted(reported)
    assert reported[-1] <= 1.0


def test_a_near_image_needs_no_larger_pixels(objective):
    settings = {"non_negative": True, "iterations": 3, "tolerance": 0.0, "usual": 3}
    truth = np.stack([LOG.rasterise(SIZE, 300.0)] * 2).astype(np.float32)
    near = descend_by_levels(objective, truth, **settings)
    assert (near.values < objective(truth, np.arange(2))[0]).all()
    assert near.iterations.tolist() == [3, 3]


def test_pixels_that_only_left_out_rays_cross_are_as_their_surroundings(objective):
    """Behind thick metal: without estimates of these rays they would have 0.15 times that attenuation."""
    projector = objective.projector
    hole = Phantom("hole", (Disc((30.0, -20.0), 12.0, 1.0),)).rasterise(SIZE, 300.0).astype(np.float32)
    left_out = np.repeat(projector.forward(hole)[None] > 0.0, 2, axis=0)
    rays = replace(
        objective,
        lines=bridged_samples(objective.lines, left_out).astype(np.float32),
        weights=np.where(left_out, np.float32(0.0), objective.weights),
        prior=replace(objective.prior, strength=objective.prior.strength / 10.0),
    )
    found = descend_by_levels(rays, non_negative=True, iterations=300, tolerance=5e-3, usual=20)
    inside, around = hole > 0.5, binary_dilation(hole > 0.0, iterations=6) & (hole == 0.0)
    for image in found.images:
        assert image[inside].mean() == pytest.approx(image[around].mean(), rel=0.2)


SMALL, FIELD_MM, NOISE = 48, 400.0, 0.05
SETTINGS = {"non_negative": True, "iterations": 200, "tolerance": 1e-5}


def scanned(irregular_turn, radius_mm):
    """Two scans of a log: the objective, the support region and first images on it."""
    scanner, theta = Scanner(860.0, 3 * SMALL, 1000.0 / (3 * SMALL)), Theta(0.7, 700.0, 150.0, 60.0, 0.15)
    geometry = FanBeamGeometry(scanner, theta, irregular_turn(15, 1201))
    projector = Projector(geometry, ImageGrid(SMALL, FIELD_MM))
    log = Phantom("log with a core", (Disc((5.0, -8.0), radius_mm, 0.018), Disc((0.0, 0.0), 30.0, 0.006)))
    lines = projector.block(np.stack([simulate_sinogram(log, geometry, noise=0.02, seed=n) for n in (1, 2)]))
    # Convex: there is one lowest value, whatever the way.
    prior = TotalVariationPrior(np.full(2, 4e-4), np.full(2, 1000.0), np.full(2, 0.02))
    objective = Objective(projector, lines, np.full(lines.shape, 1.0 / NOISE**2, np.float32), prior)
    support = SupportRegion.of(projector, lines)
    return objective, support, mean_along_rays(support.projector, lines)


def test_the_support_region_first_leads_as_low_as_the_full_grid_at_once(irregular_turn):
    objective, support, start = scanned(irregular_turn, 80.0)
    assert support.is_small
    in_turn = descend_from_support(objective, support, start, **SETTINGS, usual=40)
    at_once = descend(objective, support.embedded(start), **SETTINGS)
    # Both have converged when eight iterations gain less than 1e-5; what is left to gain is some times as much.
    np.testing.assert_allclose(in_turn.values, at_once.values, rtol=1e-4)
    assert in_turn.converged.all()
    values, _ = objective(in_turn.images, np.arange(2))
    np.testing.assert_allclose(in_turn.values, values, rtol=1e-6)
    # The noise of the air is explained beside the log too.
    in_turn.images[:, *support.part] = 0.0
    assert (in_turn.images.max(axis=(1, 2)) > 0.0).all()


def test_a_log_that_fills_the_field_is_solved_for_on_the_full_grid_at_once(irregular_turn):
    objective, support, start = scanned(irregular_turn, 150.0)
    assert not support.is_small
    in_turn = descend_from_support(objective, support, start, **SETTINGS, usual=40)
    at_once = descend(objective, support.embedded(start), **SETTINGS)
    np.testing.assert_array_equal(in_turn.images, at_once.images)
    assert in_turn.iterations.tolist() == at_once.iterations.tolist()


def test_both_descents_together_keep_to_the_iterations(irregular_turn):
    objective, support, start = scanned(irregular_turn, 80.0)
    found = descend_from_support(objective, support, start, **SETTINGS | {"iterations": 9}, usual=40)
    assert found.iterations.tolist() == [9, 9]
    assert not found.converged.any()
    # Some are left for the air, which six on the support region leave as it is.
    near = Objective(support.projector, objective.lines, objective.weights, objective.prior)
    before = descend(near, start, **SETTINGS | {"iterations": int(9 * SUPPORT_ITERATION_SHARE)})
    assert (found.values < objective(support.embedded(before.images), np.arange(2))[0]).all()


@pytest.mark.parametrize("radius_mm", [80.0, 150.0])
def test_the_share_of_the_work_only_rises(irregular_turn, radius_mm):
    objective, support, start = scanned(irregular_turn, radius_mm)
    reported = []
    descend_from_support(objective, support, start, **SETTINGS, usual=40, on_progress=reported.append)
    assert reported == sorted(reported)
    assert 0.0 < reported[0] < 0.1
    # The rest, where it ends sooner than most, is for the caller to report.
    assert 0.5 < reported[-1] <= 1.0
