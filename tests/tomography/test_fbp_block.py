"""A block of slices, views a quarter turn apart, and the slice by itself are one algorithm."""

import numpy as np
import pytest

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, GeometryError
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_vocabulary import FilterName

# Positions on the detector are in single precision, 1e-4 of a cell, and views are summed in another order.
ROUNDING = 1e-4


@pytest.fixture
def projector(scanner, theta):
    def of(angles, size=65):
        return Projector(FanBeamGeometry(scanner, theta, angles), ImageGrid(size, 400.0))

    return of


def noise(views, slices, seed):
    return np.random.default_rng(seed).standard_normal((views, slices, 768)).astype(np.float32)


@pytest.mark.parametrize("slices", [1, 3, 5, 16, 33])
def test_a_block_is_its_slices(projector, irregular_turn, slices):
    # 38 views: no multiple of the views that are summed at a time. 65 pixels: no multiple of a tile.
    at = projector(irregular_turn(38, 701))
    stack = noise(38, slices, 702)
    volume = fbp(at, stack.transpose(1, 0, 2)).image
    assert volume.shape == (slices, 65, 65)
    for n in {0, slices // 2, slices - 1}:
        np.testing.assert_allclose(volume[n], fbp(at, stack[:, n]).image, atol=ROUNDING * np.abs(volume[n]).max())


@pytest.mark.parametrize("weighting", ["exact", "none"])
@pytest.mark.parametrize("sense", [1, -1])
def test_views_a_quarter_turn_apart_are_views_like_any_other(projector, full_turn, weighting, sense):
    angles, order = sense * full_turn(40), np.random.default_rng(703).permutation(40)
    stack = noise(40, 5, 704)
    options = {"filter_name": FilterName.COSINE, "frequency_scaling": 0.8, "weighting": weighting}
    shared = fbp(projector(angles, 64), stack[:, 0], **options).image
    for other in (
        fbp(projector(angles[order] + TAU, 64), stack[order, 0], **options).image,
        fbp(projector(angles, 64), stack.transpose(1, 0, 2), **options).image[0],
    ):
        np.testing.assert_allclose(shared, other, atol=ROUNDING * np.abs(shared).max())


def test_a_block_of_another_shape_is_refused(projector, full_turn):
    with pytest.raises(GeometryError, match=r"the block has shape \(5, 11, 768\).*\(any, 10, 768\)"):
        fbp(projector(full_turn(10)), noise(11, 5, 705).transpose(1, 0, 2))
