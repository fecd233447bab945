"""From Python, too: fields apart, folders of images and linked HDF5."""

import h5py
import numpy as np
import pytest
import tifffile

import sawmill_calibration as sawmill

VIEWS, ROWS, CELLS = 12, 2, 16
GIVEN = {"data": "counts", "source_to_cor_mm": 859.46, "angles_deg": "0:30", "detector_pitch_mm": 1.5}


@pytest.fixture
def images(tmp_path):
    """Counts as one array, with its flats, and the same as a folder."""
    rng = np.random.default_rng(1422)
    views = rng.integers(5_000, 25_000, (VIEWS, ROWS, CELLS)).astype(np.uint16)
    np.savez(tmp_path / "scan.npz", projections=views, flats=np.full((3, ROWS, CELLS), 30_000, np.uint16))
    (tmp_path / "views").mkdir()
    for index, image in enumerate(views):
        tifffile.imwrite(tmp_path / f"views/{index}.tif", image)
    tifffile.imwrite(tmp_path / "air.tif", np.full((ROWS, CELLS), 30_000, np.uint16))
    return tmp_path


def test_a_folder_with_flats_beside_it_is_the_same_scan(images):
    whole = sawmill.read_scan(images / "scan.npz", **GIVEN)
    apart = sawmill.read_scan(str(images / "views"), flats=str(images / "air.tif"), **GIVEN)
    np.testing.assert_array_equal(apart.line_integrals, whole.line_integrals)
    assert apart.sha256 != whole.sha256


def test_links_are_followed_when_asked(images):
    scan = np.load(images / "scan.npz")
    with h5py.File(images / "data.h5", "w") as file:
        file["x"] = scan["projections"]
    with h5py.File(images / "master.h5", "w") as file:
        file["projections"], file["flats"] = h5py.ExternalLink("data.h5", "x"), scan["flats"]
    with pytest.raises(sawmill.InputError, match="external link"):
        sawmill.read_scan(images / "master.h5", **GIVEN)
    read = sawmill.read_scan(images / "master.h5", follow_links=True, **GIVEN)
    np.testing.assert_array_equal(read.line_integrals, sawmill.read_scan(images / "scan.npz", **GIVEN).line_integrals)
