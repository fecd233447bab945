import numpy as np
import pytest

from sawmill_tomography.sinograms.air import faulty_cells, median_of_views

VIEWS, CELLS = 60, 120
CENTRE, RADIUS = 62.0, 34.0
NOISE = 0.01


def sinogram(seed, noise=NOISE):
    """A disc that wobbles about the rotation centre, 3 deep."""
    across = np.arange(CELLS) - CENTRE - 8.0 * np.sin(np.arange(VIEWS) * 2.0 * np.pi / VIEWS)[:, None]
    depth = 3.0 / RADIUS * np.sqrt(np.maximum(RADIUS**2 - across**2, 0.0))
    return (depth + noise * np.random.default_rng(seed).standard_normal(depth.shape)).astype(np.float32)


def found(sinogram):
    return faulty_cells(sinogram, median_of_views(sinogram))


def test_a_sound_row_has_no_found():
    assert not found(sinogram(1)).any()
    assert not found(sinogram(1, noise=0.0)).any()


@pytest.mark.parametrize("value", [0.0, 7.0])
def test_cells_that_stand_still_stand_out_or_amplify_are_found(value):
    broken = sinogram(2)
    broken[:, 60] = value
    broken[:, 75] += 2.0
    assert np.flatnonzero(found(broken)).tolist() == [60, 75]
    broken = sinogram(3)
    broken[:, 50] *= 1.5
    assert np.flatnonzero(found(broken)).tolist() == [50]


def test_a_row_of_unequal_cells_is_structure_and_an_empty_one_has_nothing_to_find():
    comb = sinogram(4)
    comb[:, ::8] += 2.0
    assert not found(comb).any()
    assert not found(np.zeros((VIEWS, CELLS), np.float32)).any()
