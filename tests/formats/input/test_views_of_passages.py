"""Views that are passages through a fixed pair: few, with angles that say nothing; else they are refused as before."""

import h5py
import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.reading import reading_scan


def written(path, views: int) -> np.ndarray:
    """Write line integrals with equal angles, as NPZ or NXtomo."""
    lines, angles = np.random.default_rng(52).uniform(0.5, 2.0, (views, 3, 8)), np.full(views, 30.0)
    if path.suffix == ".npz":
        np.savez(path, projections=lines, angles_deg=angles)
        return lines
    with h5py.File(path, "w") as file:
        file["entry/definition"], file["entry/instrument/detector/data"] = "NXtomo", lines
        file["entry/instrument/detector/image_key"] = np.zeros(views, int)
        file["entry/sample/rotation_angle"] = angles
        file["entry/sample/rotation_angle"].attrs["units"] = "degree"
    return lines


@pytest.mark.parametrize("suffix", ["npz", "nxs"])
@pytest.mark.parametrize(("views", "otherwise"), [(1, "at least 3"), (2, "at least 3"), (4, "the same direction")])
def test_passages_are_read_and_refused_as_scans_of_an_object_that_turns(tmp_path, suffix, views, otherwise):
    path = tmp_path / f"scan.{suffix}"
    lines = written(path, views)
    with reading_scan(path, counts=False, turns=False) as scan:
        read = np.concatenate([block.samples for block in scan.blocks(2**20)])
    np.testing.assert_array_equal(read.reshape(lines.shape), lines.astype(np.float32))
    np.testing.assert_array_equal(scan.angles_rad, 0.0)
    with pytest.raises(UnreadableScan, match=otherwise), reading_scan(path, counts=False):
        pass
