"""Views that are passages through a fixed pair: few, and their angles say nothing; other scans are refused as before."""

import h5py
import numpy as np
import pytest

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.reading import reading_scan

ROWS, CELLS = 3, 8
OF_ANGLES = {"nxtomo": "entry/sample/rotation_angle", "exchange": "exchange/theta"}


@pytest.fixture(params=["npz", "nxtomo", "exchange"])
def write(request, tmp_path):
    """Write line integrals (views, rows, cells) with equal angles."""

    def written(views: int):
        lines = np.random.default_rng(52).uniform(0.5, 2.0, (views, ROWS, CELLS))
        path, angles = tmp_path / f"scan.{request.param}", np.full(views, 30.0)
        if request.param == "npz":
            with path.open("wb") as stream:
                np.savez(stream, projections=lines, angles_deg=angles)
        else:
            with h5py.File(path, "w") as file:
                file[OF_ANGLES[request.param]] = angles
                if request.param == "exchange":
                    file["exchange/data"] = lines
                else:
                    file["entry/definition"], file["entry/instrument/detector/data"] = "NXtomo", lines
                    file["entry/instrument/detector/image_key"] = np.zeros(views, int)
                file[OF_ANGLES[request.param]].attrs["units"] = "degree"
        return path, lines

    return written


@pytest.mark.parametrize("views", [1, 2, 4])
def test_passages_are_read_whatever_their_number_and_their_angles(write, views):
    path, lines = write(views)
    with reading_scan(path, counts=False, turns=False) as scan:
        read = np.concatenate([block.samples for block in scan.blocks(2**20)])
    np.testing.assert_array_equal(read.reshape(lines.shape), lines.astype(np.float32))
    np.testing.assert_array_equal(scan.angles_rad, 0.0)


@pytest.mark.parametrize(
    ("views", "words"),
    [(1, "at least 3"), (2, "at least 3"), (4, "views 0 and 1 have the same direction (30 degrees)")],
)
def test_the_same_file_is_no_scan_of_an_object_that_turns(write, views, words):
    path, _ = write(views)
    with pytest.raises(UnreadableScan) as refusal, reading_scan(path, counts=False):
        pass
    assert words in str(refusal.value)
