"""The normal equations of the fit of fixed pairs."""

import numpy as np
import pytest
from passed_boards import passed_board

from sawmill_tomography.calibration.joint_fit.wood_patches import wood_patches
from sawmill_tomography.pairs.coarse import Placed
from sawmill_tomography.pairs.fine import CORNERS, FANS, OPTICS, PATCHES, SCATTERED, SLOPES, VIEWS, WOOD, FineFit


@pytest.fixture
def fit() -> FineFit:
    """Two pairs and two passages at the true places; no unknown is 0 but the slopes of the density."""
    rng = np.random.default_rng(20)
    passed = passed_board("beam and detector", 2, 2, 20)
    poses = np.array([[*one.place_mm, one.roll_rad] for one in passed.lies])
    fit = FineFit(passed.drawing, passed.data, Placed(passed.frames, poses, 0.0), from_counts=True, corner_mm=0.3)
    for part, size in {SLOPES: 1e-3, WOOD: 1e-3, CORNERS: 0.3, OPTICS: 0.02, VIEWS: 0.02}.items():
        own = fit.x[fit.layout.part(part)]
        own += size * rng.uniform(0.3, 1.0, own.size)
    fit.x[fit.layout.part(WOOD)][2:] = [2.0, 0.0, 0.0]  # rounded corners, mm^2; the columns take no slope into account
    optics = fit.x[fit.layout.part(OPTICS)].reshape(2, -1)
    optics[:, 0], optics[:, SCATTERED] = 2.0, 0.005  # blur, cells^2
    fit.vary_fans_and_densities()
    fit.x[fit.layout.part(FANS)] = rng.normal(0.0, np.tile([5.0, 0.01, 0.01], 2))
    fit.x[fit.layout.part(PATCHES)] = rng.normal(0.0, 0.02, fit.layout.patches)
    return fit


def test_columns_are_the_central_differences_of_the_prediction(fit):
    steps = np.full(fit.layout.size, 1e-3)
    steps[fit.layout.part(CORNERS)] = 0.05
    steps[0:10:5] = steps[4:10:5] = steps[fit.layout.part(SLOPES)] = 1e-5
    off = np.zeros(fit.layout.size)
    for number in range(2):
        places, columns, _ = fit.columns(fit.x, number)
        assert len(set(places)) == len(places) == len(columns)
        for place, column in zip(places, columns / np.sqrt(fit.weights[number]), strict=True):
            step = steps[place] * (np.arange(fit.layout.size) == place)
            ends = [fit.prediction(fit.x + way * step, number) for way in (1, -1)]
            difference = (ends[0] - ends[1]) / (2.0 * steps[place])
            share = np.linalg.norm(column - difference) / np.linalg.norm(difference)
            off[place] = max(off[place], share)
    assert 0.0 < off.min() < off.max() < 0.05


def test_the_number_of_patches_is_the_drawings_wherever_the_corners_are(fit):
    corners = fit.x[fit.layout.part(CORNERS)]
    corners += np.random.default_rng(1).normal(0.0, 20.0, corners.size)
    assert len(wood_patches(fit.model(fit.x, 0).drawing)) != fit.layout.patches
    fit.vary_fans_and_densities()
    assert [len(patches) for patches in fit.patches] == [fit.layout.patches] * 2
