"""The disc in which ray errors are counted, where nobody states the largest log."""

import pytest

from sawmill_tomography.calibration.sinogram_data import counted_radius_mm
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom

SMALL = Phantom("disc", (Disc((0.0, 0.0), 35.0), Disc((10.0, 0.0), 5.0, -1.0)))


@pytest.mark.parametrize(
    ("stated_mm", "phantom", "radius_mm"),
    [
        (None, L_SHAPE, 150.0),
        (None, RECTANGLE_WITH_HOLE, 150.0),
        (None, SMALL, 35.0),
        (None, SMALL.moved(3.0, 4.0), 40.0),  # off the rotation centre it reaches further out
        (220.0, SMALL, 220.0),
        (20.0, L_SHAPE, 20.0),
    ],
)
def test_what_is_stated_counts_or_the_phantom_s_reach_up_to_150_mm(stated_mm, phantom, radius_mm):
    assert counted_radius_mm(stated_mm, phantom) == pytest.approx(radius_mm, rel=1e-12)
