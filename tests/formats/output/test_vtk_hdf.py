"""What VTK's reader makes of a volume: the very same values, at the places that the axes name."""

import h5py
import numpy as np
import pytest
from scan_files import new_volume


@pytest.fixture
def volume_of(tmp_path, rng):
    """Write a volume of a number of slices and open it."""

    def write(slices, row_pitch_mm=20.0):
        values = rng.random((slices, 6, 4), dtype=np.float32)
        places = {"centre_mm": (10.0, -30.0), "first_slice_mm": 100.0 if row_pitch_mm else 0.0}
        with new_volume(tmp_path / "volume.h5", values.shape, row_pitch_mm=row_pitch_mm, **places) as volume:
            volume.write(0, values)
        return h5py.File(tmp_path / "volume.h5")

    return write


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
def test_each_value_lies_where_the_axes_say(volume_of, slices, row_pitch_mm):
    with volume_of(slices, row_pitch_mm) as file:
        data = file["entry/data"]
        along, x_mm, y_mm = (data[axis][()] for axis in data.attrs["axes"])
        seen, written = seen_by_vtk(file, "attenuation"), data["data"]
        assert len(seen) == written.size
        for (n, i, j), value in np.ndenumerate(written[()]):
            # Places are sums of few short binary fractions, which are exact.
            assert seen[x_mm[i], y_mm[j], along[n]] == value


def test_its_axes_are_right_handed(volume_of):
    # Others are placed as well, but drawn from behind.
    with volume_of(3) as file:
        assert np.linalg.det(file["VTKHDF"].attrs["Direction"].reshape(3, 3)) == pytest.approx(1.0)


# VTK takes an image of one slice from two axes.
@pytest.mark.parametrize(("slices", "shape"), [(3, (3, 6, 4)), (1, (6, 4))])
def test_nothing_is_stored_twice(volume_of, slices, shape):
    with volume_of(slices) as file:
        for values in file["VTKHDF/PointData"].values():
            assert (values.shape, values.is_virtual) == (shape, True)
        assert file["entry/data/data"] == file["entry/reconstruction/data"]


def test_the_reader_recognises_the_group(volume_of):
    with volume_of(3) as file:
        attributes = file["VTKHDF"].attrs
        # It takes texts of fixed length only.
        assert attributes.get_id("Type").dtype == np.dtype("S9")
        assert attributes["Type"] == b"ImageData"
        assert attributes["Version"].tolist() == [1, 0]
        assert file["VTKHDF/PointData/attenuation"].attrs["Attribute"] == b"Scalars"
