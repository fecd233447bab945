"""The disc in which ray errors are counted, where nobody states the largest log."""

import pytest

from sawmill_tomography.calibration.sinogram_data import counted_radius_mm
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom

SMALL = Phantom("disc", (Disc((0.0, 0.0), 35.0), Disc((10.0, 0.0), 5.0, -1.0)))


@pytest.mark.parametrize("phantom", [L_SHAPE, RECTANGLE_WITH_HOLE], ids=lambda phantom: phantom.name)
def test_the_published_phantoms_reach_the_150_mm_that_are_assumed(phantom):
    assert counted_radius_mm(None, phantom) == 150.0


def test_a_small_phantom_is_judged_where_it_was():
    assert counted_radius_mm(None, SMALL) == 35.0
    # Off the rotation centre it reaches further out.
    assert counted_radius_mm(None, SMALL.moved(3.0, 4.0)) == pytest.approx(40.0)


def test_what_is_stated_counts():
    assert counted_radius_mm(220.0, SMALL) == 220.0
    assert counted_radius_mm(20.0, L_SHAPE) == 20.0
