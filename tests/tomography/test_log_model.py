import math

import numpy as np
import pytest

from sawmill_tomography.phantoms.log_model import HEARTWOOD_PER_MM, METAL_PER_MM, SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Polygon

FIELD = 300.0


def image_at(log, height, size=300):
    return log.slice_at(height).rasterise(size, FIELD, subsamples=2)


def test_equal_seeds_give_equal_logs_and_other_seeds_others():
    assert LogModel.random(1001) == LogModel.random(1001)
    assert LogModel.random(1001) != LogModel.random(1002)
    assert LogModel.random(1001).slice_at(123.0) == LogModel.random(1001).slice_at(123.0)


@pytest.mark.parametrize("seed", range(1003, 1008))
def test_a_slice_is_wood_inside_the_bark_and_nothing_outside(seed):
    log = LogModel.random(seed)
    axis = (np.arange(300) + 0.5) - 150.0
    radius = np.hypot(axis[:, None], axis[None, :])
    for height in (10.0, 60.0, 130.0, 310.0):
        image = image_at(log, height)
        assert not image[radius > log.radius_mm + 1.5].any()
        wood = image[radius < log.radius_mm - 1.5]
        assert wood.min() > 0.5 * HEARTWOOD_PER_MM
        assert HEARTWOOD_PER_MM < wood.mean() < SAPWOOD_PER_MM * 1.2


def test_a_whorl_has_knots_and_clear_wood_has_none():
    log = LogModel.random(1008)
    knots = {h: [s for s in log.slice_at(h).shapes if isinstance(s, Polygon)] for h in (60.0, 5.0)}
    assert len(knots[60.0]) >= 2
    assert not knots[5.0]


def test_the_metal_is_where_it_was_put_and_only_there():
    log = LogModel.random(1009)
    inside, away = image_at(log, log.metal_height_mm), image_at(log, log.metal_height_mm + 60.0)
    i, j = (math.floor(c + FIELD / 2) for c in log.metal_mm)
    assert inside[i, j] > METAL_PER_MM
    assert away.max() < 0.2 * METAL_PER_MM


def test_a_slice_stays_within_its_log():
    for seed in range(1010, 1020):
        log = LogModel.random(seed)
        assert log.slice_at(60.0).radius_mm < 1.2 * log.radius_mm
