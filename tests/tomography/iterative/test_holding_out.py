from dataclasses import replace

import numpy as np
import pytest

from sawmill_worker.tomography.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.holding_out import ROUNDS, hold_out, shown_without
from sawmill_worker.tomography.iterative.penalised import Objective, Prior
from sawmill_worker.tomography.phantom import Disc, Phantom
from sawmill_worker.tomography.projector import Projector

SIZE, NOISE = 32, 0.05
LOG = Phantom("log", (Disc((0.0, 10.0), 130.0, 0.015), Disc((20.0, -10.0), 50.0, 0.006)))
# Trusted as far as it goes, and not at all.
STRENGTHS = np.array([30.0, 1e5])
# A scanner that is nearly one of parallel rays.
FAR = FanBeamGeometry(Scanner(1e6, 128, 4.0), Theta(0.4, 1.0, 0.0, 0.0, 0.0), np.arange(40) * np.pi / 20.0)


def projector_of(views, irregular_turn):
    geometry = FanBeamGeometry(
        Scanner(860.0, 96, 10.5), Theta(0.4, 700.0, 80.0, 20.0, 0.1), irregular_turn(views, 1401)
    )
    return Projector(geometry, ImageGrid(SIZE, 400.0))


def objective_of(projector):
    noise = NOISE * np.random.default_rng(1402).standard_normal(projector.geometry.sinogram_shape)
    lines = (projector.forward(LOG.rasterise(SIZE, 400.0)) + noise).astype(np.float32)[None]
    weights = np.full(lines.shape, 1.0 / NOISE**2, np.float32)
    scale = np.full(STRENGTHS.size, 3e-4)
    return Objective(projector, lines, weights, Prior("total-variation", scale, STRENGTHS, scale))


def held(objective, starts, iterations=15):
    noise = np.full((1, 1), NOISE)
    return hold_out(objective, noise, starts, exponent=1.0, iterations=iterations, non_negative=True)


def shown(objective):
    return shown_without(objective.only(0), np.zeros((SIZE, SIZE), np.float32), non_negative=True)


def test_what_explains_the_scan_foretells_views_and_rays_better(irregular_turn):
    objective = objective_of(projector_of(23, irregular_turn))
    found = held(objective, shown(objective))
    assert found.images.shape == (ROUNDS, 2, SIZE, SIZE)
    assert found.in_views[0] < 0.8 * found.in_views[1]
    assert found.in_rays[0] < 0.5 * found.in_rays[1]
    # Noise alone would give 1; 23 views of a blocky log with some noise left in it, somewhat more.
    assert 0.9 < found.in_rays[0] < 2.0


def test_each_round_knows_nothing_of_what_it_keeps_back(irregular_turn):
    views = 6
    objective = objective_of(projector_of(views, irregular_turn))
    starts = shown(objective)
    plain = held(objective, starts, iterations=1).images
    unmoved = np.zeros((views, ROUNDS), int)
    for view in range(views):
        lines = objective.lines.copy()
        lines[:, view] = 0.0
        other = held(replace(objective, lines=lines), starts, iterations=1).images
        unmoved[view] = np.isclose(other, plain).all(axis=(1, 2, 3))
    # Every view is unknown to one round.
    np.testing.assert_array_equal(unmoved.sum(axis=1), 1)
    # One of each five neighbours.
    np.testing.assert_array_equal(unmoved[:ROUNDS].sum(axis=0), 1)


def test_with_the_exponent_one_the_power_is_that_of_the_image():
    projector = Projector(FAR, ImageGrid(SIZE, 400.0))
    rng = np.random.default_rng(1403)
    ratios = []
    for _ in range(4):
        image = np.zeros((SIZE, SIZE), np.float32)
        low, high = sorted(rng.choice(np.arange(6, 26), 2, replace=False))
        image[low:high, 8:20] = rng.uniform(0.5, 2.0)
        lines = projector.forward(image)[None]
        objective = Objective(projector, lines, np.ones_like(lines), objective_of(projector).prior.only(0))
        # Without an iteration the image stays empty, and misses all that there is.
        found = held(objective, np.zeros((ROUNDS, SIZE, SIZE), np.float32), iterations=0)
        ratios.append(found.in_views[0] / np.square(image).sum())
    # The pixels' sharp edges have frequencies beyond the cells', narrow bars more of them.
    np.testing.assert_allclose(ratios, np.mean(ratios), rtol=0.1)


@pytest.mark.parametrize("views", [1, 2, 4])
def test_few_views_are_kept_back_one_by_one_and_a_single_one_is_not(views, irregular_turn):
    objective = objective_of(projector_of(views, irregular_turn))
    found = held(objective, shown(objective))
    assert len(found.images) == views
    if views == 1:
        np.testing.assert_array_equal(found.in_views, 1.0)
    assert np.isfinite(found.in_views).all()
    assert np.isfinite(found.in_rays).all()
