import h5py
import numpy as np
import pytest

from worker.storage.arrays import projection, sinogram, volume_slice
from worker.storage.errors import Invalid


@pytest.fixture
def stack() -> np.ndarray:
    """(views, rows, detector)"""
    return np.random.default_rng(3).random((5, 3, 8), dtype=np.float32)


@pytest.fixture
def scan(tmp_path, stack):
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file["/entry/instrument/detector/data"] = stack
        file["/entry/instrument/detector/x_pixel_size"] = 1.5
        file["/entry/sample/rotation_angle"] = np.arange(5) * 72.0
    return path


def test_a_sinogram_is_one_row_of_the_stack(scan, stack):
    read = sinogram(scan, 2)
    np.testing.assert_array_equal(read.data, stack[:, 2, :])
    np.testing.assert_array_equal(read.angles_deg, [0, 72, 144, 216, 288])
    assert read.pitch_mm == 1.5


def test_a_projection_is_one_view_of_the_stack(scan, stack):
    np.testing.assert_array_equal(projection(scan, 4), stack[4])


def test_a_slice_is_one_of_the_volume_s(tmp_path, stack):
    path = tmp_path / "volume.h5"
    with h5py.File(path, "w") as file:
        file["/entry/reconstruction/data"] = stack
        file["/entry/reconstruction/data"].attrs["units"] = "1/mm"
        file["/entry/reconstruction/x"] = (np.arange(3) - 1) * 2.5
    read = volume_slice(path, 1)
    np.testing.assert_array_equal(read.data, stack[1])
    assert (read.pixel_mm, read.unit) == (2.5, "1/mm")


@pytest.mark.parametrize("row", [-1, 3])
def test_a_row_that_is_not_there_is_told_with_the_range(scan, row):
    with pytest.raises(Invalid, match=f"row must be between 0 and 2, not {row}"):
        sinogram(scan, row)
