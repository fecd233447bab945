import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
from scan_files import new_volume, read_stored_scan

from sawmill_formats.errors import OutOfRange, UnreadableScan
from sawmill_formats.output.scan_reader import open_scan, sinogram
from sawmill_formats.output.scan_writer import write_scan
from sawmill_formats.output.volume_reader import check_volume, side_view, volume_slice, volume_slices
from sawmill_platform.errors import DamagedResult


@pytest.fixture
def stack() -> np.ndarray:
    """(views, rows, detector)"""
    return np.random.default_rng(3).random((5, 3, 8), dtype=np.float32)


@pytest.fixture
def scan(tmp_path, stack):
    path = tmp_path / "scan.h5"
    write_scan(
        path,
        line_integrals=stack,
        angles_rad=np.deg2rad(np.arange(5) * 72.0),
        detector_pitch_mm=1.5,
        row_pitch_mm=None,
        air_level=None,
        provenance={},
    )
    return path


def test_a_sinogram_is_one_row_of_the_stack(scan, stack):
    read = sinogram(scan, stack.shape, 2)
    np.testing.assert_array_equal(read.data, stack[:, 2, :])
    np.testing.assert_allclose(read.angles_deg, [0, 72, 144, 216, 288])
    assert read.pitch_mm == 1.5


def test_deviations_are_read_as_what_they_are_of_and_damaged_values_are_refused(scan, stack):
    with h5py.File(scan, "a") as file:
        file["/entry/instrument/detector/data_errors"] = stack / 9
        place = file["/entry/instrument/detector/data"].id.get_chunk_info(0).byte_offset
    views = np.array([3, 1])
    read = read_stored_scan(scan, slice(1, 3), views)
    np.testing.assert_array_equal(read.line_integrals, stack[views, 1:3])
    np.testing.assert_array_equal(read.deviations, stack[views, 1:3] / 9)
    with scan.open("r+b") as file:
        file.seek(place)
        file.write(b"damaged!")
    with open_scan(scan) as opened:
        np.testing.assert_array_equal(opened.deviations_of(range(3)), stack / 9)
        with pytest.raises(UnreadableScan):
            opened.rows(range(3))


@pytest.fixture
def volume(tmp_path):
    """Write a volume of 3 x 4 x 4 random numbers as jobs do: the file, and what is in it."""

    def write(row_pitch_mm):
        slices = np.random.default_rng(4).random((3, 4, 4), dtype=np.float32)
        path = tmp_path / "volume.h5"
        places = {"centre_mm": (10.0, -20.0), "first_slice_mm": 60.0}
        with new_volume(path, slices.shape, pixel_mm=2.5, row_pitch_mm=row_pitch_mm, **places) as volume_file:
            volume_file.write(0, slices[:2])
            volume_file.write(2, slices[2:])
        return path, slices

    return write


def test_a_slice_is_one_of_the_volume_s(volume):
    path, slices = volume(None)
    read = volume_slice(path, slices.shape, 1)
    np.testing.assert_array_equal(read.data, slices[1])
    assert (read.pixel_mm, read.unit) == (2.5, "1/mm")
    assert (read.height_mm, read.label) == (None, "slice 1")


def test_slices_know_where_they_lie_along_the_log(volume):
    path, slices = volume(20.0)
    read = list(volume_slices(path, slices.shape, [2, 0]))
    np.testing.assert_array_equal([one.data for one in read], slices[[2, 0]])
    assert [one.label for one in read] == ["slice 2, 100 mm", "slice 0, 60 mm"]
    with pytest.raises(OutOfRange, match="slice must be between 0 and 2, not 3"):
        list(volume_slices(path, slices.shape, [0, 3]))


def test_side_views_are_the_densest_along_their_axis(volume):
    path, slices = volume(20.0)
    along_x, along_y = side_view(path, slices.shape, "x"), side_view(path, slices.shape, "y")
    np.testing.assert_array_equal(along_x.data, slices.max(axis=1))
    np.testing.assert_array_equal(along_y.data, slices.max(axis=2))
    assert (along_x.across, along_x.across_mm, along_x.along_mm) == ("y", (-25.0, -15.0), (50.0, 110.0))
    assert (along_y.across, along_y.across_mm, along_y.unit) == ("x", (5.0, 15.0), "1/mm")


def test_a_side_view_of_slices_without_spacing_has_no_length(volume):
    path, slices = volume(None)
    assert side_view(path, slices.shape, "x").along_mm is None


def test_a_slice_that_unpacks_to_more_is_refused_and_takes_no_more_memory_than_its_own(tmp_path):
    path, shape = tmp_path / "volume.h5", (1, 64, 64)
    with new_volume(path, shape) as volume_file:
        volume_file.write(0, np.ones(shape, np.float32))
    volume_slice(path, shape, 0)
    with h5py.File(path, "r+") as file:
        bomb = zlib.compress(bytes(2**23)) + bytes(4)
        file["entry/reconstruction/data"].id.write_direct_chunk((0, 0, 0), bomb)
    check_volume(path, shape)
    tracemalloc.start()
    with pytest.raises(DamagedResult, match="does not hold the 16384 bytes"):
        volume_slice(path, shape, 0)
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 2**18


@pytest.mark.parametrize("row", [-1, 3])
def test_a_row_that_is_not_there_is_refused_with_the_range(scan, stack, row):
    with pytest.raises(OutOfRange, match=f"row must be between 0 and 2, not {row}"):
        sinogram(scan, stack.shape, row)
