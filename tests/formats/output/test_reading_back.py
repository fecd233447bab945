"""Scans and volumes of ours: packed and read back, and a volume as VTK's reader sees it."""

import struct
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
from scan_files import new_volume, read_stored_scan, write_scan

from sawmill_formats.errors import OutOfRange, UnreadableScan, library_errors_translated, quoted
from sawmill_formats.nexus import PACKED
from sawmill_formats.output.scan_reader import open_scan, sinogram
from sawmill_formats.output.volume_reader import check_volume, side_view, volume_slice, volume_slices
from sawmill_formats.output.volume_writer import fletcher32, pack, write_chunk
from sawmill_platform.errors import DamagedResult
from sawmill_platform.files.whole_files import DISK_AWAY


@pytest.fixture
def stack() -> np.ndarray:
    """(views, rows, detector)"""
    return np.random.default_rng(3).random((5, 3, 8), dtype=np.float32)


@pytest.fixture
def scan(tmp_path, stack):
    about = {"detector_pitch_mm": 1.5, "row_pitch_mm": None}
    write_scan(tmp_path / "scan.h5", line_integrals=stack, angles_rad=np.deg2rad(np.arange(5) * 72.0), **about)
    return tmp_path / "scan.h5"


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


def volume(tmp_path, row_pitch_mm):
    """Write a volume of 3 x 4 x 4 random numbers as jobs do: the file, and what is in it."""
    slices = np.random.default_rng(4).random((3, 4, 4), dtype=np.float32)
    path = tmp_path / "volume.h5"
    places = {"centre_mm": (10.0, -20.0), "first_slice_mm": 60.0}
    with new_volume(path, slices.shape, pixel_mm=2.5, row_pitch_mm=row_pitch_mm, **places) as volume_file:
        volume_file.write(0, slices[:2])
        volume_file.write(2, slices[2:])
    return path, slices


def test_a_slice_is_one_of_the_volume_s_and_knows_where_it_lies_along_the_log(tmp_path):
    path, slices = volume(tmp_path, None)
    read = volume_slice(path, slices.shape, 1)
    np.testing.assert_array_equal(read.data, slices[1])
    assert (read.pixel_mm, read.unit) == (2.5, "1/mm")
    assert (read.height_mm, read.label) == (None, "slice 1")
    path, slices = volume(tmp_path, 20.0)
    read = list(volume_slices(path, slices.shape, [2, 0]))
    np.testing.assert_array_equal([one.data for one in read], slices[[2, 0]])
    assert [one.label for one in read] == ["slice 2, 100 mm", "slice 0, 60 mm"]
    with pytest.raises(OutOfRange, match="slice must be between 0 and 2, not 3"):
        list(volume_slices(path, slices.shape, [0, 3]))


def test_side_views_are_the_densest_along_their_axis_and_have_no_length_without_spacing(tmp_path):
    path, slices = volume(tmp_path, 20.0)
    along_x, along_y = side_view(path, slices.shape, "x"), side_view(path, slices.shape, "y")
    np.testing.assert_array_equal(along_x.data, slices.max(axis=1))
    np.testing.assert_array_equal(along_y.data, slices.max(axis=2))
    assert (along_x.across, along_x.across_mm, along_x.along_mm) == ("y", (-25.0, -15.0), (50.0, 110.0))
    assert (along_y.across, along_y.across_mm, along_y.unit) == ("x", (5.0, 15.0), "1/mm")
    path, slices = volume(tmp_path, None)
    assert side_view(path, slices.shape, "x").along_mm is None


def test_a_slice_that_unpacks_to_more_is_refused_and_takes_no_more_memory_than_its_own(tmp_path):
    path, shape = tmp_path / "volume.h5", (1, 64, 64)
    with new_volume(path, shape) as volume_file:
        volume_file.write(0, np.ones(shape, np.float32))
    volume_slice(path, shape, 0)
    with h5py.File(path, "r+") as file:
        file["entry/reconstruction/data"].id.write_direct_chunk((0, 0, 0), zlib.compress(bytes(2**23)) + bytes(4))
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


def dataset(tmp_path, shape):
    """A dataset (3, *shape) float32, one chunk to each index, and its file's path."""
    file = h5py.File(tmp_path / "packed.h5", "w")
    return file, file.create_dataset("data", (3, *shape), "f4", chunks=(1, *shape), **PACKED, fletcher32=True)


@pytest.mark.parametrize("shape", [(64, 48), (3, 5), (1, 1)])
@pytest.mark.parametrize("kind", ["noise", "zeros", "constant"])
def test_the_library_reads_what_was_packed(tmp_path, shape, kind):
    rng = np.random.default_rng(731)
    values = {"noise": rng.standard_normal((3, *shape)), "zeros": np.zeros((3, *shape)), "constant": 1e-3}[kind]
    values = np.broadcast_to(values, (3, *shape)).astype(np.float32)
    file, data = dataset(tmp_path, shape)
    for index, chunk in enumerate(values):
        write_chunk(data, index, pack(chunk))
    file.close()
    with h5py.File(tmp_path / "packed.h5") as again:
        np.testing.assert_array_equal(again["data"], values)


def test_the_checksum_is_the_library_s_where_a_sum_of_65535_stays(tmp_path):
    file, data = dataset(tmp_path, (40, 41))
    data[...] = np.random.default_rng(732).standard_normal((3, 40, 41))
    file.flush()
    for index in range(3):
        _, stored = data.id.read_direct_chunk((index, 0, 0))
        assert struct.pack("<I", fletcher32(stored[:-4])) == stored[-4:]
    file.close()
    assert fletcher32(b"\xff\xff") == 0xFFFFFFFF
    assert fletcher32(b"\0\0\0") == 0
    assert fletcher32(b"\x01") == 0x01000100


def test_a_damaged_chunk_is_reported(tmp_path):
    file, data = dataset(tmp_path, (64, 48))
    write_chunk(data, 0, pack(np.random.default_rng(733).standard_normal((64, 48)).astype(data.dtype)))
    offset = data.id.get_chunk_info(0).byte_offset
    file.close()
    whole = bytearray((tmp_path / "packed.h5").read_bytes())
    whole[offset + 100] ^= 1
    (tmp_path / "packed.h5").write_bytes(whole)
    with h5py.File(tmp_path / "packed.h5") as again, pytest.raises(OSError, match=r"checksum|filter"):
        again["data"][0]


def volume_of(tmp_path, rng, slices, row_pitch_mm=20.0):
    values = rng.random((slices, 6, 4), dtype=np.float32)
    places = {"centre_mm": (10.0, -30.0), "first_slice_mm": 100.0 if row_pitch_mm else 0.0}
    with new_volume(tmp_path / "volume.h5", values.shape, row_pitch_mm=row_pitch_mm, **places) as volume:
        volume.write(0, values)
    return h5py.File(tmp_path / "volume.h5")


def seen_by_vtk(file, name):
    """Values with their places (x, y, z), as VTK's reader lays them out: an array's last axis is its first, i."""
    group = file["VTKHDF"]
    low, high = group.attrs["WholeExtent"].reshape(3, 2).T
    assert not low.any()
    values = group["PointData"][name][()].reshape(high[::-1] + 1)
    ijk = np.argwhere(np.ones(values.shape))[:, ::-1]
    places = group.attrs["Origin"] + (ijk * group.attrs["Spacing"]) @ group.attrs["Direction"].reshape(3, 3).T
    return dict(zip(map(tuple, places), values.ravel(), strict=True))


@pytest.mark.parametrize(("slices", "row_pitch_mm"), [(3, 20.0), (3, None), (1, 20.0), (1, None)])
def test_each_value_lies_where_the_axes_say(tmp_path, rng, slices, row_pitch_mm):
    with volume_of(tmp_path, rng, slices, row_pitch_mm) as file:
        data = file["entry/data"]
        along, x_mm, y_mm = (data[axis][()] for axis in data.attrs["axes"])
        seen, written = seen_by_vtk(file, "attenuation"), data["data"]
        assert len(seen) == written.size
        for (n, i, j), value in np.ndenumerate(written[()]):
            # Places are sums of few short binary fractions, which are exact.
            assert seen[x_mm[i], y_mm[j], along[n]] == value


def test_its_axes_are_right_handed(tmp_path, rng):
    # Others are placed as well, but drawn from behind.
    with volume_of(tmp_path, rng, 3) as file:
        assert np.linalg.det(file["VTKHDF"].attrs["Direction"].reshape(3, 3)) == pytest.approx(1.0)


# VTK takes an image of one slice from two axes.
@pytest.mark.parametrize(("slices", "shape"), [(3, (3, 6, 4)), (1, (6, 4))])
def test_nothing_is_stored_twice(tmp_path, rng, slices, shape):
    with volume_of(tmp_path, rng, slices) as file:
        for values in file["VTKHDF/PointData"].values():
            assert (values.shape, values.is_virtual) == (shape, True)
        assert file["entry/data/data"] == file["entry/reconstruction/data"]


def test_the_reader_recognises_the_group(tmp_path, rng):
    with volume_of(tmp_path, rng, 3) as file:
        attributes = file["VTKHDF"].attrs
        # It takes texts of fixed length only.
        assert attributes.get_id("Type").dtype == np.dtype("S9")
        assert (attributes["Type"], attributes["Version"].tolist()) == (b"ImageData", [1, 0])
        assert file["VTKHDF/PointData/attenuation"].attrs["Attribute"] == b"Scalars"


NO_USE = "its structure makes no sense"


@pytest.mark.parametrize(
    ("error", "passed_on"),
    [
        (ValueError("bad\nheader"), "bad header"),
        (ValueError("To allow loading, fully trust the file using `allow_pickle=True`"), NO_USE),
        (TypeError("'NoneType' object is not subscriptable"), NO_USE),
        (KeyError("databytecounts"), NO_USE),
        (ValueError("malformed node <ast.Name object at 0x7f5ed2a1e010>"), NO_USE),
        (OSError("can't open '/var/lib/sawmill/uploads/1f3a', at 1/2"), "can't open '...', at 1/2"),
        (ValueError("incorrect data check"), "incorrect data check"),
    ],
)
def test_of_a_parser_only_what_it_says_of_the_file_is_passed_on(error, passed_on):
    with pytest.raises(UnreadableScan) as refusal, library_errors_translated("NPY"):
        raise error
    assert str(refusal.value) == f"this NPY file is incomplete or damaged ({passed_on}); export it again"
    assert (refusal.value.code, refusal.value.__cause__) == ("broken-file", error)


TROUBLES = [MemoryError(), *(OSError(number, "gone") for number in sorted(DISK_AWAY))]


@pytest.mark.parametrize("trouble", TROUBLES)
def test_the_machines_troubles_are_not_the_files(trouble):
    with pytest.raises(type(trouble)) as raised, library_errors_translated("NPY"):
        raise trouble
    assert raised.value is trouble


def test_foreign_text_is_quoted_on_one_short_printable_line():
    assert quoted("a\x1b[31m\n b") == "a [31m b"
    assert len(quoted("x" * 1000)) == 200
