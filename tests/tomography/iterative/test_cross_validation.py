from dataclasses import replace

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.iterative.cross_validation import FOLDS, cross_validate, first_images_of_folds
from sawmill_tomography.reconstruction.iterative.penalised import Objective
from sawmill_tomography.reconstruction.iterative.priors import TotalVariationPrior

pytestmark = pytest.mark.slow

SIZE, NOISE = 32, 0.05
LOG = Phantom("log", (Disc((0.0, 10.0), 130.0, 0.015), Disc((20.0, -10.0), 50.0, 0.006)))
# The data weigh as much as they should, and hardly at all.
STRENGTHS = np.array([30.0, 1e5])


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
    return Objective(projector, lines, weights, TotalVariationPrior(scale, STRENGTHS, scale))


def validated(objective, starts, iterations=15):
    noise = np.full((1, 1), NOISE)
    return cross_validate(objective, noise, starts, exponent=1.0, iterations=iterations, non_negative=True)


def starts_of(objective):
    return first_images_of_folds(objective.only(0), np.zeros((SIZE, SIZE), np.float32), non_negative=True)


def test_the_candidate_that_explains_the_scan_predicts_views_and_rays_better(irregular_turn):
    objective = objective_of(projector_of(23, irregular_turn))
    found = validated(objective, starts_of(objective))
    assert found.images.shape == (FOLDS, 2, SIZE, SIZE)
    assert found.in_views[0] < 0.8 * found.in_views[1]
    assert found.in_rays[0] < 0.5 * found.in_rays[1]
    # Noise alone would give 1; 23 views of a blocky log with some noise left in it, somewhat more.
    assert 0.9 < found.in_rays[0] < 2.0


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


@pytest.mark.parametrize("views", [1, 2, 4])
def test_few_views_are_left_out_one_by_one_and_a_single_one_is_not(views, irregular_turn):
    objective = objective_of(projector_of(views, irregular_turn))
    found = validated(objective, starts_of(objective))
    assert len(found.images) == views
    if views == 1:
        np.testing.assert_array_equal(found.in_views, 1.0)
    assert np.isfinite(found.in_views).all()
    assert np.isfinite(found.in_rays).all()
