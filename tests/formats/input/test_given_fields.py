"""Flat and dark fields in files of their own, of every kind that holds one stack or one image."""

import numpy as np
import pytest
import tifffile
from scan_files import CELLS, ROWS, hdf5, mat, npz, refused, zipped

from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.reading import reading_scan

STEPS = AngleSteps(0.0, 60.0)
COUNTS = {"counts": True, "angles_deg": STEPS}


@pytest.fixture
def scan_file(tmp_path, stack):
    np.save(tmp_path / "scan.npy", stack.astype(np.uint16))
    return tmp_path / "scan.npy"


@pytest.fixture
def fields(rng):
    """(n, rows, detector), two images that differ."""
    return rng.integers(50_000, 60_000, (2, ROWS, CELLS)).astype(np.uint16)


def nxtomo_of(images, key):
    detector = "entry/instrument/detector/"
    return hdf5({"entry/definition": "NXtomo", detector + "data": images, detector + "image_key": [key] * len(images)})


WRITERS = {
    "npy": np.save,
    "npz": lambda path, images: npz(anything=images)(path),
    "npz of flats": lambda path, images: npz(flats=images, darks=images[:, ::-1])(path),
    "mat": lambda path, images: mat(flats=images)(path),
    "tiff": lambda path, images: tifffile.imwrite(path, images, metadata=None),
    "zip": lambda path, images: zipped({f"air-{n}.tif": image for n, image in enumerate(images)})(path),
    "zip of flats": lambda path, images: zipped({f"flat-{n}.tif": image for n, image in enumerate(images)})(path),
    "hdf5": lambda path, images: hdf5({"anything": images})(path),
    "nxtomo of flats": lambda path, images: nxtomo_of(images, 1)(path),
    "nxtomo of views": lambda path, images: nxtomo_of(images, 0)(path),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_flats_of_every_format(writer, scan_file, fields, tmp_path):
    path = tmp_path / "fields.npy"  # the name is no matter
    WRITERS[writer](path, fields)
    with reading_scan(scan_file, **COUNTS, flats=path) as scan:
        np.testing.assert_array_equal(scan.flats, fields)
        assert scan.others == (path,)


def test_one_image_is_one_field_and_a_sinogram_has_fields_of_a_row(scan_file, fields, tmp_path, stack):
    tifffile.imwrite(tmp_path / "flat.tif", fields[0])
    np.save(tmp_path / "dark.npy", fields[1])
    given = {"flats": tmp_path / "flat.tif", "darks": tmp_path / "dark.npy"}
    with reading_scan(scan_file, **COUNTS, **given) as scan:
        np.testing.assert_array_equal(scan.flats, fields[:1])
        np.testing.assert_array_equal(scan.darks, fields[1:])
        assert not any("dark" in remark for remark in scan.remarks)
    np.save(tmp_path / "scan.npy", stack[:, 0])
    np.save(tmp_path / "flats.npy", fields[:, 0])
    with reading_scan(tmp_path / "scan.npy", **COUNTS, flats=tmp_path / "flats.npy") as scan:
        np.testing.assert_array_equal(scan.flats, fields[:, :1])


def test_fields_in_both_places_beside_line_integrals_or_of_another_size_are_refused(
    nxtomo, fields, tmp_path, scan_file
):
    np.save(tmp_path / "f.npy", fields)
    refused(nxtomo(), "contradiction", "flats of its own", "--flats", counts=True, flats=tmp_path / "f.npy")
    np.save(tmp_path / "f.npy", fields)
    refused(scan_file, "contradiction", counts=False, angles_deg=STEPS, darks=tmp_path / "f.npy")
    np.save(tmp_path / "f.npy", fields[:, 1:])
    words = f"(2, {ROWS - 1}, {CELLS})", f"({ROWS}, {CELLS})"
    refused(scan_file, "wrong-shape", *words, **COUNTS, flats=tmp_path / "f.npy")


def test_what_is_wrong_with_the_fields_file_names_it(scan_file, fields, tmp_path):
    nxtomo_of(fields, 1)(tmp_path / "flats.nxs")
    given = COUNTS | {"flats": tmp_path / "flats.nxs", "darks": tmp_path / "flats.nxs"}
    assert refused(scan_file, "dataset-missing", **given).startswith("--darks 'flats.nxs': it holds no darks")
    given = COUNTS | {"flats": tmp_path / "f.npy"}
    given["flats"].write_bytes(b"\x93NUMPY\1\0\5\0what?")
    assert refused(scan_file, "broken-file", **given).startswith("--flats 'f.npy': this NPY file is incomplete")
    np.save(given["flats"], np.repeat(fields, 20, axis=0))
    assert refused(scan_file, "too-large", **given, free_bytes=2_000).startswith("--flats 'f.npy': ")
