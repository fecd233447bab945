"""Small files that ask for gigabytes or hours, and a process of its own that reads one and tells what it took."""

import multiprocessing
import resource
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py

MEBIBYTE = 2**20
# What the service's own attempts may have; a reader that asks for more has failed its test without harm.
DATA_BYTES = 2 * 2**30
# A reader that needs more is ended by the system; most need a thousandth.
PROCESSOR_SECONDS = 20
HANGS_AFTER_S = 300.0
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["sawmill_calibration.scans.inspect", "sawmill_tomography.phantoms.tracing"])


@dataclass(frozen=True)
class Outcome:
    """The way in which a reading ended, what `sawmill inspect` found, and the MiB that both took beyond idling."""

    code: str
    sentence: str
    mebibytes: float
    verdict: str = ""


def outcome(path: Path, *, counts: bool = False, dataset: str | None = None) -> Outcome:
    """Read a scan, or a picture where the file's name ends in .png, in a process that may die."""
    receiver, sender = CONTEXT.Pipe(duplex=False)
    process = CONTEXT.Process(target=_report, args=(sender, path, counts, dataset))
    process.start()
    sender.close()
    try:
        return receiver.recv() if receiver.poll(HANGS_AFTER_S) else Outcome("too-long", "", 0.0)
    except EOFError:
        return Outcome("died", "", 0.0)
    finally:
        process.kill()
        process.join()
        receiver.close()


def _report(sender, path, counts, dataset):
    from sawmill_formats.errors import FileError  # noqa: PLC0415 - preloaded where it is run

    resource.setrlimit(resource.RLIMIT_DATA, (DATA_BYTES, DATA_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_SECONDS, PROCESSOR_SECONDS))
    idle = _peak_kibibytes()
    code, sentence = "read", ""
    try:
        (_trace if path.suffix == ".png" else _read)(path, counts, dataset)
    except FileError as refusal:
        code, sentence = refusal.code, str(refusal)
    except (MemoryError, ValueError) as error:  # a PhantomError among them
        code, sentence = type(error).__name__, str(error)
    verdict = _inspect(path, counts, dataset)
    sender.send(Outcome(code, sentence, (_peak_kibibytes() - idle) / 1024, verdict))


def _read(path, counts, dataset):
    from sawmill_formats.input.angles import AngleSteps  # noqa: PLC0415
    from sawmill_formats.input.reading import reading_scan  # noqa: PLC0415

    steps = AngleSteps(0.0, 18.0)
    with reading_scan(path, counts=counts, dataset=dataset, angles_deg=steps, free_bytes=DATA_BYTES) as scan:
        for _ in scan.blocks(64 * MEBIBYTE):
            pass


def _inspect(path, counts, dataset):
    from sawmill_calibration.scans.inspect import InspectionInput, inspect_file  # noqa: PLC0415
    from sawmill_vocabulary import DataKind  # noqa: PLC0415

    data = DataKind.COUNTS if counts else DataKind.LINE_INTEGRALS
    return inspect_file(InspectionInput(path, data, dataset)).verdict.value


def _trace(path, *_):
    from sawmill_formats.input.picture import read_picture  # noqa: PLC0415
    from sawmill_tomography.phantoms.tracing import trace  # noqa: PLC0415

    trace(read_picture(path), 400.0, name="hostile")


def _peak_kibibytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def deflated(beginning: bytes, zeros: int) -> bytes:
    """A zlib stream of some bytes and then zeros, in whole MiB: one is deflated once and repeated."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    first = deflate.compress(beginning) + deflate.flush(zlib.Z_FULL_FLUSH)
    mebibyte = deflate.compress(bytes(MEBIBYTE)) + deflate.flush(zlib.Z_FULL_FLUSH)
    sums = zlib.adler32(beginning)
    low, high = sums & 0xFFFF, sums >> 16
    checksum = (high + zeros * low) % 65521 << 16 | low
    return b"\x78\xda" + first + mebibyte * (zeros // MEBIBYTE) + b"\x03\x00" + struct.pack(">I", checksum)


def checkers(path: Path, side: int = 6400) -> None:
    """A PNG of black and white pixels in turn, 13 kB: each white one is an outline of its own."""
    rows = (b"\0" + b"\xaa" * (side // 8) + b"\0" + b"\x55" * (side // 8)) * (side // 2)
    header = struct.pack(">IIBBBBB", side, side, 1, 0, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(_png_part(kind, data) for kind, data in parts))


def _png_part(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def chunk_of(
    path: Path, stored: bytes, shape: tuple[int, ...], *, deflates: int = 1, packing: int = h5py.h5z.FILTER_DEFLATE
) -> None:
    """HDF5 with one chunk, stored as those bytes whatever its shape declares, packed so often or by another filter."""
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk(shape)
    if packing == h5py.h5z.FILTER_LZF:
        layout.set_filter(packing, h5py.h5z.FLAG_OPTIONAL, (0,))
    elif packing == h5py.h5z.FILTER_SZIP:
        layout.set_szip(h5py.h5z.SZIP_NN_OPTION_MASK, 8)
    else:
        for _ in range(deflates):
            layout.set_deflate(9)
    with h5py.File(path, "w") as file:
        dataset = h5py.h5d.create(file.id, b"data", h5py.h5t.NATIVE_FLOAT, h5py.h5s.create_simple(shape), layout)
        dataset.write_direct_chunk((0,) * len(shape), stored)


def deflated_twice(path: Path, inflated: int = 2**32) -> None:
    """HDF5 whose one chunk, of 60 kB as declared, inflates to 4 GiB."""
    chunk_of(path, zlib.compress(deflated(b"", inflated), 9), (20, 1, 768), deflates=2)


def archive_of(path: Path, name: str, zlib_stream: bytes, size: int) -> None:
    """A ZIP of one member that is stored as that stream and declares that size."""
    packed = zlib_stream[2:-4]
    local = struct.pack("<4s5H3L2H", b"PK\3\4", 20, 0, 8, 0, 0, 0, len(packed), size, len(name), 0) + name.encode()
    directory = struct.pack(
        "<4s6H3L5H2L", b"PK\1\2", 20, 20, 0, 8, 0, 0, 0, len(packed), size, len(name), 0, 0, 0, 0, 0, 0
    )
    directory += name.encode()
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, len(directory), len(local) + len(packed), 0)
    path.write_bytes(local + packed + directory + end)


def pages_of(
    path: Path, strip: bytes, shape: tuple[int, int], pages: int, *, description: int = 0, compression: int = 8
) -> None:
    """A TIFF of pages of bytes that are all stored as the one strip, deflated if nothing else is said."""
    rows, cells = shape
    tags = {256: cells, 257: rows, 258: 8, 259: compression, 262: 1, 273: 8, 277: 1, 278: rows, 279: len(strip)}
    entries = b"".join(struct.pack("<2H2L", tag, 4, 1, value) for tag, value in tags.items())
    if description:
        entries += struct.pack("<2H2L", 270, 2, description, 8)
    page = struct.pack("<H", len(entries) // 12) + entries
    first = 8 + len(strip)
    links = [first + (index + 1) * (len(page) + 4) for index in range(pages - 1)]
    chain = b"".join(page + struct.pack("<L", link) for link in [*links, 0])
    path.write_bytes(struct.pack("<2sHL", b"II", 42, first) + strip + chain)


def tiles_of(path: Path, tile: int, shape: tuple[int, int], pages: int) -> None:
    """A TIFF of pages of bytes that are each stored as one tile of zeros, of `tile` x `tile` bytes in whole MiB."""
    rows, cells = shape
    stored = deflated(b"", tile * tile)
    first = 8 + len(stored) * pages
    chain = b""
    for page in range(pages):
        tags = {256: cells, 257: rows, 258: 8, 259: 8, 262: 1, 277: 1, 322: tile, 323: tile}
        tags |= {324: 8 + len(stored) * page, 325: len(stored)}
        entries = b"".join(struct.pack("<2H2L", tag, 4, 1, value) for tag, value in tags.items())
        following = first + (page + 1) * (len(entries) + 6) if page + 1 < pages else 0
        chain += struct.pack("<H", len(tags)) + entries + struct.pack("<L", following)
    path.write_bytes(struct.pack("<2sHL", b"II", 42, first) + stored * pages + chain)
