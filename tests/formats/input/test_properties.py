"""Whatever the bytes, a reader reads them or refuses them with one sentence: no other error, and no advice to trust."""

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scan_files import WHOLE, saved

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.picture import read_picture
from sawmill_formats.input.reading import reading_scan

STACK = np.random.default_rng(20261122).integers(100, 60_000, (6, 3, 8)).astype(np.uint16)
QUICK = settings(
    max_examples=60, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
THOROUGH = settings(QUICK, max_examples=2_000, derandomize=False)
quick_or_thorough = pytest.mark.parametrize(
    "examples", [QUICK, pytest.param(THOROUGH, marks=pytest.mark.nightly)], ids=["quick", "thorough"]
)
MEMORY_BYTES = 64 * 2**20
FILES = WHOLE | {"png": saved(Image.fromarray(STACK[0].astype(np.uint8)).save, format="PNG")}
# Numbers that parsers trip over, in either order of bytes, and a few bytes of anything.
NUMBERS = [n.to_bytes(w, e) for n in (0, 1, 2**16 - 1, 2**31, 2**32 - 1) for w in (4, 8) for e in ("little", "big")]
EDITS = st.lists(st.tuples(st.floats(0, 1), st.sampled_from(NUMBERS) | st.binary(max_size=8)), min_size=1, max_size=4)
KEPT_SHARES = st.just(1.0) | st.floats(0, 1)


def read_or_refused(read):
    sentence = ""
    try:
        read()
    except UnreadableScan as refusal:
        sentence = str(refusal)
    assert "\n" not in sentence
    assert "pickle" not in sentence


def read_scan(path):
    angles = AngleSteps(0.0, 60.0)
    with reading_scan(path, counts=False, angles_deg=angles, max_bytes=MEMORY_BYTES, free_bytes=MEMORY_BYTES) as scan:
        for block in scan.blocks(2**20):
            assert block.samples.dtype == np.float32


@pytest.mark.parametrize("kind", FILES)
@quick_or_thorough
def test_edited_files_are_read_or_refused(file, kind, examples):
    @examples
    @given(edits=EDITS, keep=KEPT_SHARES)
    def check(edits, keep):
        data = bytearray(FILES[kind])
        for where, new in edits:
            at = int(where * len(data))
            data[at : at + len(new)] = new
        file.write_bytes(data[: int(keep * len(data))])
        read_or_refused(lambda: (read_picture if kind == "png" else read_scan)(file))

    check()


# HDF5 whose bytes were edited may end the process that reads it (in the service it may): what varies is the structure.
NAMES = st.sampled_from(["data", "flats", "angles_deg", "exchange", "theta", "definition", "image_key", "x_pixel_size"])
PATHS = st.lists(NAMES | st.text(min_size=1, max_size=5), min_size=1, max_size=4).map("/".join)
VALUES = st.one_of(
    st.builds(
        np.ones,
        st.lists(st.integers(0, 7), max_size=4).map(tuple),
        st.sampled_from(["u1", "i8", "f2", "f8", "c8", "?", "S3", [("a", "f4")]]),
    ),
    st.sampled_from(["NXtomo", "", STACK, STACK[:, 0], h5py.SoftLink("/data"), h5py.Empty("f4")]),
)
ATTRIBUTES = st.dictionaries(st.sampled_from(["units", "axes", "MATLAB_class", "MATLAB_empty"]), VALUES, max_size=2)


MEMBERS = st.lists(st.tuples(PATHS, VALUES, ATTRIBUTES), max_size=6)


@quick_or_thorough
def test_hdf5_of_any_structure_is_read_or_refused(file, examples):
    @examples
    @given(members=MEMBERS)
    def check(members):
        with h5py.File(file, "w") as h5:
            for path, value, attributes in members:
                try:
                    h5[path] = value
                    for name, attribute in attributes.items():
                        h5[path].attrs[name] = attribute
                except (ValueError, TypeError, KeyError, OSError, RuntimeError, AttributeError):
                    continue  # what the library does not write
        read_or_refused(lambda: read_scan(file))

    check()
