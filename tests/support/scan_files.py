"""Scans in files, also as other programs write them, which the tests of readers and of our own files share."""

import io
import os
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from zipfile import ZIP_STORED, ZipFile

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.reading import reading_scan
from sawmill_formats.output.scan_reader import open_scan
from sawmill_formats.output.scan_writer import new_scan
from sawmill_formats.output.volume_writer import new_reconstruction

VIEWS, ROWS, CELLS = 6, 3, 8


def write_scan(path, *, line_integrals, air_level=None, provenance=MappingProxyType({}), row_shifts=None, **about):
    """Write a scan of ours whose line integrals are in memory."""
    with new_scan(path, line_integrals.shape, **about) as written:
        written.data[...] = line_integrals
        written.note(air_level=air_level, provenance=provenance, row_shifts=row_shifts)


def read_stored_scan(path, rows=slice(None), views=None):
    """A scan of ours, or part of it, with what the open file knows of the whole."""
    with open_scan(path) as scan:
        read = {"line_integrals": scan.rows(rows, views), "deviations": scan.deviations_of(rows, views)}
        read["angles_rad"] = scan.angles_rad if views is None else scan.angles_rad[views]
        read["air_level"] = None if scan.air_level is None else scan.air_level[rows, :]
        return SimpleNamespace(**vars(scan) | read)


@pytest.fixture
def rng():
    return np.random.default_rng(20261120)


@pytest.fixture
def stack(rng):
    """(views, rows, detector), exactly representable as float32 and uint16."""
    return rng.integers(100, 60_000, (VIEWS, ROWS, CELLS)).astype(np.float32)


@pytest.fixture
def angles_deg():
    return np.array([0.5, 60.5, 121.0, 180.5, 240.5, 300.25])


@pytest.fixture
def nxtomo(tmp_path, stack, angles_deg):
    """Write an NXtomo file: one dark, two flats, one invalid image, the views; change it through the returned group."""

    def make(change=lambda _entry: None, angle_units="degree", data_options=None):
        path = tmp_path / "scan.nxs"
        darks, flats = np.full((1, ROWS, CELLS), 7), np.full((2, ROWS, CELLS), 60_000)
        images = np.concatenate([darks, flats, np.zeros((1, ROWS, CELLS)), stack]).astype(np.uint16)
        with h5py.File(path, "w") as file:
            entry = file.create_group("scan_1")
            entry["definition"] = "NXtomo"
            detector = entry.create_group("instrument/detector")
            detector.create_dataset("data", data=images, **(data_options or {}))
            detector["image_key"] = [2, 1, 1, 3] + [0] * VIEWS
            detector["x_pixel_size"] = 0.0015
            detector["x_pixel_size"].attrs["units"] = "m"
            entry["sample/rotation_angle"] = np.concatenate([np.zeros(4), angles_deg])
            if angle_units is not None:
                entry["sample/rotation_angle"].attrs["units"] = angle_units
            change(entry)
        return path

    return make


@pytest.fixture(scope="session")
def published_data():
    folder = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", Path(__file__).parents[3] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"the published data are not at {folder}; name their folder in SAWMILL_PUBLISHED_DATA")
    return folder


@pytest.fixture
def file(tmp_path):
    return tmp_path / "upload"


def saved(write, *arguments, **named):
    stream = io.BytesIO()
    write(stream, *arguments, **named)
    return stream.getvalue()


def read_scan(path, **given):
    with reading_scan(path, **given) as scan:
        (block,) = scan.blocks(2**30)
        return replace(scan, projections=block.samples)


def refusal(path, **given):
    """The code and the sentence that refuse a file, at the latest where its samples are read."""
    with pytest.raises(UnreadableScan) as refused, reading_scan(path, **given) as scan:
        for _ in scan.blocks(2**26):
            pass
    assert "\n" not in str(refused.value)
    return refused.value.code, str(refused.value)


def refused(path, code, *words, **given):
    found, sentence = refusal(path, **given)
    assert found == code, sentence
    assert [word for word in words if word not in sentence] == [], sentence
    return sentence


def each_refusal(path):
    """Parametrise a test with the name, the code and the sentence of each line of a text file."""
    rows = [line.split(" | ") for line in path.read_text("utf-8").splitlines()]
    return pytest.mark.parametrize(("name", "code", "sentence"), rows, ids=[name for name, *_ in rows])


def new_volume(path, shape, **changes):
    """A volume's writer, whose numbers say nothing but what a test asks of them."""
    about = {"geometry": {}, "parameters": {}, "software_version": "0", "input_sha256": "0" * 64}
    return new_reconstruction(path, shape, **{"pixel_mm": 1.5, "row_pitch_mm": None, "unit": "1/mm"} | about | changes)


def hdf5(members, attributes=()):
    """A dataset of each value, a group of each None, by their paths; (path, name, value) of attributes."""

    def write(path):
        with h5py.File(path, "w") as file:
            for name, value in members.items():
                if value is None:
                    file.create_group(name)
                else:
                    file[name] = value
            for member, name, value in attributes:
                file[member].attrs[name] = value

    return write


def npy(array):
    def write(path):
        with path.open("wb") as stream:
            np.save(stream, array, allow_pickle=array.dtype.hasobject)

    return write


def npz(**arrays):
    def write(path):
        with path.open("wb") as stream:
            np.savez(stream, **arrays)

    return write


def mat(*, packed=False, **variables):
    return lambda path: scipy.io.savemat(path, variables, appendmat=False, do_compression=packed)


def zipped(members, method=ZIP_STORED):
    """An archive of bytes and of images, which are packed as TIFFs."""

    def write(path):
        with ZipFile(path, "w", method) as archive:
            for name, content in members.items():
                archive.writestr(name, saved(tifffile.imwrite, content) if isinstance(content, np.ndarray) else content)

    return write


def _page_by_page(stream, stack):
    with tifffile.TiffWriter(stream) as tiff:
        for view in stack:
            tiff.write(view, contiguous=False, metadata=None)


_SMALL = np.random.default_rng(20261122).integers(100, 60_000, (VIEWS, ROWS, CELLS)).astype(np.uint16)
_VARIABLES = {"scan": {"sinogram": _SMALL[:, 0], "parameters": {"angles": np.arange(6.0), "note": "text"}}}
# The bytes of a small scan as a file of each kind but HDF5.
WHOLE = {
    "npy": saved(np.save, _SMALL),
    "npz": saved(np.savez_compressed, data=_SMALL, angles_deg=60.0 * np.arange(6)),
    "mat": saved(scipy.io.savemat, _VARIABLES),
    "one array in mat": saved(scipy.io.savemat, {"arr": _SMALL[:, 0]}),
    "packed mat": saved(scipy.io.savemat, _VARIABLES, do_compression=True),
    "tiff": saved(tifffile.imwrite, _SMALL, compression="zlib", metadata=None),
    "plain tiff": saved(tifffile.imwrite, _SMALL, metadata=None),
    "tiff page by page": saved(_page_by_page, _SMALL),
    "big tiff": saved(tifffile.imwrite, _SMALL, bigtiff=True, byteorder=">", metadata=None),
    "zip": saved(zipped({f"{n}.tif": saved(tifffile.imwrite, _SMALL[n], compression="zlib") for n in range(VIEWS)})),
}
