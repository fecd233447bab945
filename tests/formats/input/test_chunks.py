"""HDF5 storage that holds less than it declares: refused, and nothing of this process's memory is read for it."""

import struct
import time
import zlib

import h5py
import numpy as np
import pytest
from scan_files import refused as refused_of

from sawmill_formats.input.angles import AngleSteps
from sawmill_formats.input.reading import reading_scan

SHAPE = (6, 2, 16)
STACK = np.random.default_rng(5).integers(0, 9, SHAPE).astype(np.uint8)
WHOLE = STACK.tobytes()
STEPS = AngleSteps(0.0, 60.0)
NOT_WHOLE = WHOLE[:100]


def with_checksum(data):
    with h5py.File("sum", "w", driver="core", backing_store=False) as file:
        one = file.create_dataset("a", data=np.frombuffer(data, np.uint8), chunks=(len(data),), fletcher32=True)
        return one.id.read_direct_chunk((0,))[1]


def dataset_of(file, stored, *filters, skipped=0, libver="earliest"):
    """HDF5 with one dataset in one chunk, stored as these bytes whatever its filters make of them."""
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk(SHAPE)
    layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    for each in filters:
        {
            "shuffle": layout.set_shuffle,
            "deflate": lambda: layout.set_deflate(4),
            "lzf": lambda: layout.set_filter(h5py.h5z.FILTER_LZF, h5py.h5z.FLAG_OPTIONAL, (0,)),
            "checksum": layout.set_fletcher32,
        }[each]()
    with h5py.File(file, "w", libver=libver) as h5:
        dataset = h5py.h5d.create(h5.id, b"data", h5py.h5t.STD_U8LE, h5py.h5s.create_simple(SHAPE), layout)
        dataset.write_direct_chunk((0, 0, 0), stored, skipped)


def samples(file, **options):
    with reading_scan(file, counts=False, **{"angles_deg": STEPS} | options) as scan:
        return np.concatenate([block.samples for block in scan.blocks(2**26)])


def refused(file, code, *words, **options):
    return refused_of(file, code, *words, counts=False, **{"angles_deg": STEPS} | options)


@pytest.mark.parametrize("libver", ["earliest", "latest"])
@pytest.mark.parametrize(
    ("filters", "stored", "skipped"),
    [
        (["shuffle"], NOT_WHOLE, 0),
        (["checksum"], with_checksum(NOT_WHOLE), 0),
        (["deflate"], zlib.compress(NOT_WHOLE), 0),
        (["deflate"], zlib.compress(WHOLE)[:-5], 0),
        (["shuffle", "deflate", "checksum"], with_checksum(zlib.compress(NOT_WHOLE)), 0),
        (["lzf"], b"\x03abcd", 0),
        (["deflate"], NOT_WHOLE, 1),
        (["lzf"], NOT_WHOLE, 1),
        (["shuffle", "deflate"], NOT_WHOLE, 2),
        (["deflate", "checksum"], with_checksum(NOT_WHOLE), 1),
        (["deflate", "checksum"], WHOLE[:-1], 3),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_a_chunk_that_holds_less_than_it_declares_is_refused(file, filters, stored, skipped, libver):
    dataset_of(file, stored, *filters, skipped=skipped, libver=libver)
    assert refused(file, "truncated-file") in {
        "the chunk (0, 0, 0) of '/data' declares 192 bytes of data and holds less; export the file again",
        "a chunk of 'data' declares 192 bytes of data and the file stores 100 for them; export it again",
    }


def test_a_chunk_without_filters_that_holds_less_than_it_declares_is_refused(file):
    dataset_of(file, NOT_WHOLE)
    refused(file, "truncated-file", "a chunk of 'data' declares 192 bytes of data and the file stores 100 for them")


@pytest.mark.parametrize(
    ("filters", "stored", "skipped", "words"),
    [
        (["lzf"], b"\x20\x00", 0, "refer to what is not there"),
        (["lzf"], b"\xff", 0, "cut off"),
        (["checksum"], WHOLE + b"\0\0\0\0", 0, "does not have the checksum"),
        (["deflate"], WHOLE, 0, "incorrect header check"),
        (["deflate", "checksum"], WHOLE + b"\0\0\0\0", 1, "does not have the checksum"),
    ],
)
def test_a_chunk_that_cannot_be_unpacked_is_refused(file, filters, stored, skipped, words):
    dataset_of(file, stored, *filters, skipped=skipped)
    refused(file, "broken-file", words)


@pytest.mark.parametrize("filters", [[], ["shuffle"], ["deflate"]])
def test_a_chunk_that_holds_more_than_it_declares_is_refused(file, filters):
    dataset_of(file, zlib.compress(WHOLE + b"\0") if "deflate" in filters else WHOLE + b"\0", *filters)
    refused(file, "too-large", "declares 192 bytes of data and")


def test_chunks_far_larger_than_their_dataset_are_refused_before_they_are_unpacked(file):
    """Chunks of which the dataset uses a few values each: two thousand times what is stored."""
    with h5py.File(file, "w") as h5:
        options = {"chunks": (1, 2048, 2048), "maxshape": (None,) * 3, "compression": "gzip"}
        h5.create_dataset("data", (20, 2, 16), "u1", **options)[:] = 1
    refused(file, "too-large", "the chunks of 'data' unpack to 83886080 bytes while the file stores only")


@pytest.mark.nightly
@pytest.mark.parametrize("libver", ["earliest", "latest"])
def test_forty_thousand_chunks_take_seconds_and_not_minutes(file, libver):
    """Not the square of their number, as where each is looked for among all the others."""
    with h5py.File(file, "w", libver=libver) as h5:
        h5.create_dataset("data", data=np.ones((4000, 10, 4), "u1"), chunks=(1, 1, 4), shuffle=True)
    before_s = time.process_time()
    assert samples(file, angles_deg=AngleSteps(0.0, 0.09)).shape == (4000, 10, 4)
    assert time.process_time() - before_s < 8


@pytest.mark.parametrize("name", ["exchange/data", "angles_deg", "flats"])
def test_whatever_is_read_beside_the_projections_is_whole_too(file, name):
    with h5py.File(file, "w") as h5:
        if name != "exchange/data":
            h5["data"] = STACK
        part = h5.create_dataset(name, (6, 2, 16) if name != "angles_deg" else (6,), "f8", chunks=True, shuffle=True)
        part.id.write_direct_chunk((0,) * part.ndim, b"\1")
    refused(file, "truncated-file", **({"angles_deg": None} if name == "angles_deg" else {}))


def test_the_parts_of_an_nxtomo_and_of_matlab_are_whole_too(nxtomo, file):
    for part in ("instrument/detector/data", "instrument/detector/image_key", "sample/rotation_angle"):

        def shorten(entry, part=part):
            values = entry[part][()]
            units = dict(entry[part].attrs)
            del entry[part]
            entry.create_dataset(part, data=values, chunks=values.shape, compression=1).attrs.update(units)
            entry[part].id.write_direct_chunk((0,) * values.ndim, zlib.compress(b"\1"))

        refused_of(nxtomo(shorten), "truncated-file", "holds less", counts=True)
    dataset_of(file, zlib.compress(b"\1"), "deflate")
    with h5py.File(file, "a") as h5:
        h5["data"].attrs["MATLAB_class"] = np.bytes_("uint8")
    refused(file, "truncated-file", angles_deg=AngleSteps(0.0, 20.0))


def test_a_definition_shorter_than_its_chunk_is_refused(file):
    with h5py.File(file, "w") as h5:
        text = h5.create_group("entry").create_dataset("definition", (1,), "S64", chunks=(1,), shuffle=True)
        text.id.write_direct_chunk((0,), b"N")
    refused(file, "truncated-file")


@pytest.mark.parametrize("kind", ["link", "virtual"])
def test_chunks_in_other_files_are_whole_too(file, tmp_path, kind):
    dataset_of(tmp_path / "source.h5", NOT_WHOLE, "shuffle")
    with h5py.File(file, "w") as h5:
        if kind == "link":
            h5["data"] = h5py.ExternalLink("source.h5", "data")
        else:
            layout = h5py.VirtualLayout(SHAPE, "u1")
            layout[:] = h5py.VirtualSource("source.h5", "data", SHAPE)
            h5.create_virtual_dataset("data", layout)
    refused(file, "truncated-file", follow_links=True)


def test_a_missing_chunk_is_refused_though_their_number_is_right(file):
    with h5py.File(file, "w") as h5:
        h5.create_dataset("data", data=STACK, chunks=(3, 2, 16), compression=1)
        size = h5["data"].id.get_chunk_info(1).size
    stored = file.read_bytes()
    key = struct.pack("<2I4Q", size, 0, 3, 0, 0, 0)
    assert stored.count(key) == 1
    file.write_bytes(stored.replace(key, struct.pack("<2I4Q", size, 0, 6, 0, 0, 0)))
    refused(file, "truncated-file", "the chunk (3, 0, 0) of '/data' was never written")


@pytest.mark.parametrize("layout", ["contiguous", "compact"])
def test_data_in_one_piece_shorter_than_declared_are_refused(file, layout):
    options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    options.set_layout(h5py.h5d.COMPACT if layout == "compact" else h5py.h5d.CONTIGUOUS)
    with h5py.File(file, "w") as h5:
        data = h5py.h5d.create(h5.id, b"data", h5py.h5t.STD_U8LE, h5py.h5s.create_simple(SHAPE), options)
        data.write(h5py.h5s.ALL, h5py.h5s.ALL, STACK)
        at = data.get_offset()
    stored = file.read_bytes()
    declared, shorter = (
        (struct.pack("<2Q", at, 192), struct.pack("<2Q", at, 100))
        if layout == "contiguous"
        else (struct.pack("<2BH", 3, 0, 192) + WHOLE, struct.pack("<2BH", 3, 0, 100) + WHOLE)
    )
    assert stored.count(declared) == 1
    file.write_bytes(stored.replace(declared, shorter))
    refused(file, "truncated-file" if layout == "contiguous" else "broken-file")


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"shuffle": True},
        {"compression": "gzip", "shuffle": True, "fletcher32": True},
        {"compression": "lzf", "shuffle": True},
        {"fletcher32": True},
    ],
)
@pytest.mark.parametrize("dtype", ["u1", ">i2", "f4", ">f8"])
def test_whole_chunks_are_read_as_they_were_written(file, options, dtype):
    stack = np.random.default_rng(6).integers(0, 99, (7, 5, 100)).astype(dtype)
    stack[:, 2:] = 7  # long runs of one value
    with h5py.File(file, "w") as h5:
        h5.create_dataset("data", data=stack, chunks=(3, 2, 64), **options)
    np.testing.assert_array_equal(samples(file), stack)


@pytest.mark.parametrize("shuffle", [False, True])
def test_numbers_that_numpy_does_not_have_are_converted(file, shuffle):
    """12 bits of 16, and numbers of 5 bytes."""
    twelve, five = h5py.h5t.STD_I16LE.copy(), h5py.h5t.IEEE_F32LE.copy()
    twelve.set_precision(12)
    five.set_size(5)
    for stored_as in (twelve, five):
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_chunk(SHAPE)
        if shuffle:
            layout.set_shuffle()
        with h5py.File(file, "w") as h5:
            data = h5py.h5d.create(h5.id, b"data", stored_as, h5py.h5s.create_simple(SHAPE), layout)
            data.write(h5py.h5s.ALL, h5py.h5s.ALL, STACK.astype("i2") - 5)
        np.testing.assert_array_equal(samples(file), STACK.astype("i2") - 5)
