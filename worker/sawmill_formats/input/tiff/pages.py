"""Multi-page TIFF files: one view a page, or the sinogram of a single row as one page.

The chain of pages of a TIFF, followed and added up before the library uses it. Layout: Adobe, "TIFF Revision 6.0",
section 2; BigTIFF's layout differs in the widths of numbers.

Meaning of the numbers of a TIFF's page: tags and descriptions that change the values or flip the image. Layout:
Adobe, "TIFF Revision 6.0", section 8. ImageJ's description states a function of the stored numbers.
"""

import math
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input import arrays
from sawmill_formats.input.contents import FileContents, Projections, Wanted, held
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

if TYPE_CHECKING:
    import tifffile


BITS_PER_SAMPLE, PHOTOMETRIC, ORIENTATION = 258, 262, 274
MIN_IS_WHITE, STRAIGHT_LINE = 0, "0"
COLOURS = {3: "a palette", 32803: "a colour filter"}
# Orientations that begin at the right, and at the bottom; above 4 rows are stored as columns.
FROM_RIGHT, FROM_BOTTOM, LARGEST_ORIENTATION = {2, 3}, {3, 4}, 4
LONGEST_DESCRIPTION = 4096


@dataclass(frozen=True)
class PageValues:
    """Steps from the stored numbers of a page to the image that it means, and remarks on them."""

    scaling: arrays.Scaling
    orientation: int
    remarks: tuple[Reason, ...]

    def image(self, stored: NDArray[Any]) -> NDArray[np.float32]:
        """Return the image (rows, detector) float32 that the stored numbers mean; they may be changed."""
        along_rows, along_cells = (-1 if self.orientation in of else 1 for of in (FROM_BOTTOM, FROM_RIGHT))
        return arrays.as_float32(self.scaling.apply(stored))[::along_rows, ::along_cells]


def page_values(page: "tifffile.TiffPage | tifffile.TiffFrame", where: str) -> PageValues:
    """Read what tags and the first page's description state: `wrong-type`, `unsupported-storage`."""
    first, number_type = page.parent.pages.first, np.dtype(page.dtype)
    tags: tifffile.TiffTags = getattr(page, "tags", first.tags)
    photometric, orientation = tags.valueof(PHOTOMETRIC, 1), max(1, tags.valueof(ORIENTATION, 1))
    if photometric in COLOURS:
        raise UnreadableScan(
            "wrong-type",
            f"{where} has {COLOURS[photometric]} (PhotometricInterpretation {photometric}); export grey values",
        )
    if orientation > LARGEST_ORIENTATION:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} has the Orientation {orientation}: its rows are stored as columns; export it with Orientation 1",
        )
    remarks: list[Reason] = []
    factor, added = 1.0, 0.0
    if photometric == MIN_IS_WHITE and number_type.kind == "u":
        factor, added = -1.0, 2.0 ** int(tags.valueof(BITS_PER_SAMPLE)) - 1.0
        remarks.append(ReadingMessage.WHITE_IS_ZERO(largest=int(added)))
    elif photometric == MIN_IS_WHITE:
        remarks.append(ReadingMessage.WHITE_IS_ZERO_UNUSED())
    if orientation > 1:
        remarks.append(ReadingMessage.ORIENTATION(orientation=orientation))
    stated = arrays.Scaling()
    if first.is_imagej and number_type.kind in "iu":
        stated = _function_of_imagej(where, first.description[:LONGEST_DESCRIPTION])
    scaling = arrays.Scaling(stated.scale * factor, stated.scale * added + stated.offset)
    return PageValues(scaling, orientation, (*remarks, *stated.remarks()))


def _function_of_imagej(where: str, description: str) -> arrays.Scaling:
    function = dict(re.findall(r"^(cf|c0|c1)=(.*)$", description, re.MULTILINE))
    curve = function.setdefault("cf", STRAIGHT_LINE)
    if curve != STRAIGHT_LINE:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where} has the calibration function {quoted(curve)!r} of ImageJ (cf), which is no straight line; export "
            "the calibrated values as 32-bit floating-point numbers",
        )
    return stated_scaling(where, "ImageJ (c1, c0)", function.get("c1", "1"), function.get("c0", "0"))


def stated_scaling(where: str, names: str, scale: str, offset: str, *, inverse: bool = False) -> arrays.Scaling:
    """Return scale x number + offset, or the inverse of this, as a file's texts state it: `unsupported-storage`."""
    scaling = arrays.Scaling.of(names, _number(scale), _number(offset), inverse=inverse)
    if scaling is None:
        raise UnreadableScan(
            "unsupported-storage",
            f"{where}: scale and offset of the stored numbers, by {names}, are {quoted(scale)!r} and "
            f"{quoted(offset)!r}; export the values as 32-bit floating-point numbers",
        )
    return scaling


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


UNCOMPRESSED = 1
PACKINGS = {8: arrays.DEFLATE, 32946: arrays.DEFLATE, 32773: arrays.PACKBITS}
READABLE_COMPRESSIONS = frozenset({UNCOMPRESSED, *PACKINGS})
# A tile that reaches beyond its page is unpacked as a whole: at most this number of times the page's pixels, or the
# usual 256 x 256 for a small page.
MOST_TILE_PAGES, USUAL_TILE_PIXELS = 4, 256 * 256


@dataclass(frozen=True, eq=False)
class TiffPages:
    """The pages (pages, rows, detector) of an open file, all checked and of one size, read when they are needed."""

    shape: tuple[int, int, int]
    tiff: "tifffile.TiffFile"
    values: Sequence[PageValues]

    @property
    def remarks(self) -> tuple[Reason, ...]:
        """Steps from stored numbers to images, each as the first page has it that needs it."""
        return tuple({remark.message: remark for values in self.values[::-1] for remark in values.remarks}.values())

    def read(self, pages: slice, rows: slice) -> NDArray[np.float32]:
        """Read some rows of some pages, (pages, rows, detector) float32."""
        block = np.empty((pages.stop - pages.start, rows.stop - rows.start, self.shape[2]), dtype=np.float32)
        for index, image in enumerate(block, pages.start):
            page = self.tiff.pages[index]
            _check_unpacked(page, f"a strip or tile of page {index}")
            # Zeros, because the library does not write the parts that it does not fill.
            image[:] = self.values[index].image(page.asarray(out=np.zeros(page.shape, page.dtype), maxworkers=1))[rows]
        return block


def read_tiff(path: Path, selection: Wanted, bounds: arrays.Bounds, files: ExitStack) -> FileContents:
    """Read a TIFF file, which stays open for its pages; a single page is the sinogram of one row."""
    if selection.dataset is not None:
        raise UnreadableScan(
            "contradiction", f"a TIFF file has no named arrays; leave out dataset {quoted(selection.dataset)!r}"
        )
    pages = files.enter_context(open_pages(path, "the file", path.stat().st_size, bounds))
    count, rows, _ = pages.shape
    if count == 1:
        sinogram = held(pages.read(slice(0, 1), slice(0, rows))[0])
        return FileContents("tiff", sinogram, remarks=(ReadingMessage.SINGLE_PAGE(), *pages.remarks))
    return FileContents("tiff", Projections(pages.shape, pages.read, (1, rows)), remarks=pages.remarks)


@contextmanager
def opened_tiff(source: Path | BinaryIO, name: str, size_bytes: int) -> Iterator["tifffile.TiffFile"]:
    """Open one TIFF of at least one page, of which only the chain of pages has been checked."""
    import tifffile  # noqa: PLC0415 - no other format waits for it

    try:
        opened = tifffile.TiffFile(source)
    except tifffile.TiffFileError as error:
        raise UnreadableScan(
            "broken-file", f"{name} is incomplete or damaged (it does not begin as a TIFF file does); export it again"
        ) from error
    with opened as tiff:
        if not tiff.pages:
            raise UnreadableScan("wrong-shape", f"{name} has 0 pages; a scan has one for each view")
        check_chain(tiff, name, size_bytes)
        yield tiff


@contextmanager
def open_pages(source: Path | BinaryIO, name: str, size_bytes: int, bounds: arrays.Bounds) -> Iterator[TiffPages]:
    """Open one TIFF and check all pages.

    Only pages are used, never the series of OME or other dialects, which may name other files.
    """
    with opened_tiff(source, name, size_bytes) as tiff:
        count = len(tiff.pages)
        first = tiff.pages[0]
        itemsize = _number_type(first, name).itemsize
        for what, shape, most in (
            (name, (count, *first.shape), bounds.array),
            (f"a page of {name}", first.shape, bounds.piece),
        ):
            arrays.check_size(what, shape, itemsize, stored_bytes=size_bytes, max_bytes=most)
        claimed = unpacked = 0
        offsets: set[int] = set()
        values: list[PageValues] = []
        for index, page in enumerate(tiff.pages):
            _check_page(page, f"page {index} of {name}", first.shape, size_bytes, bounds.piece)
            values.append(page_values(page, f"page {index} of {name}"))
            claimed += sum(page.databytecounts)
            is_shared = not offsets.isdisjoint(page.dataoffsets)
            offsets.update(page.dataoffsets)
            if is_shared or claimed > size_bytes:
                raise UnreadableScan(
                    "too-large",
                    f"pages 0 to {index} of {name} claim to be stored in {claimed} bytes of its {size_bytes}: they "
                    "share their data; store each page on its own",
                )
            unpacked += len(page.dataoffsets) * math.prod(page.chunks) * itemsize
            if unpacked > max(arrays.HARMLESS_BYTES, arrays.LARGEST_RATIO * size_bytes):
                raise UnreadableScan(
                    "too-large",
                    f"the strips or tiles of pages 0 to {index} of {name} unpack to {unpacked} bytes and the file has "
                    f"{size_bytes}; above {arrays.HARMLESS_BYTES >> 20} MiB they may unpack to at most "
                    f"{arrays.LARGEST_RATIO} times as many: store the pages in strips",
                )
        if count == 1:
            _check_nothing_follows(tiff.pages.first, name, size_bytes)
        rows, cells = first.shape
        yield TiffPages((count, rows, cells), tiff, values)


def _check_nothing_follows(page: "tifffile.TiffPage", name: str, size_bytes: int) -> None:
    """Refuse a page with images behind it, as ImageJ writes above 4 GiB, and tifffile with `truncate`."""
    description = page.description[:LONGEST_DESCRIPTION]
    images = re.search(r"^images=([0-9]{1,9})$", description, re.MULTILINE) if page.is_imagej else None
    stated = int(images[1]) if images else 2 if '"truncated": true' in description else 1
    if stated > 1 and page.dataoffsets[0] + stated * page.nbytes <= size_bytes:
        raise UnreadableScan(
            "wrong-shape",
            f"{name} has one page, and more images behind it that have none ({stated} or more in all, as ImageJ writes "
            "more than 4 GiB); export it with a page for each view, as a BigTIFF",
        )


def page_type(page: "tifffile.TiffPage | tifffile.TiffFrame") -> tuple[str, str | None]:
    """Describe the type of a page's numbers and their compression in words."""
    method = getattr(page.compression, "name", str(page.compression))
    number_type = "unknown" if page.dtype is None else str(page.dtype.name)
    return number_type, None if page.compression == UNCOMPRESSED else method.lower()


def _number_type(page: "tifffile.TiffPage | tifffile.TiffFrame", where: str) -> np.dtype[Any]:
    if page.dtype is None:
        raise UnreadableScan(
            "wrong-type", f"{where} is of no known type; a scan holds integers or floating-point numbers"
        )
    dtype: np.dtype[Any] = page.dtype
    arrays.check_number_type(where, dtype)
    return dtype


def _check_page(
    page: "tifffile.TiffPage | tifffile.TiffFrame", where: str, shape: tuple[int, ...], size_bytes: int, most_bytes: int
) -> None:
    itemsize = _number_type(page, where).itemsize
    if len(page.shape) != 2 or page.shape != shape:
        other = f" and page 0 {shape}" if page.shape != shape else ""
        axes = "" if len(page.shape) == 2 else f": this has {len(page.shape)} axes"
        raise UnreadableScan(
            "wrong-shape",
            f"{where} has the shape {page.shape}{other}; every page must be (rows, detector), grey, of one size{axes}",
        )
    if int(page.compression) not in READABLE_COMPRESSIONS:
        method = getattr(page.compression, "name", page.compression)
        raise UnreadableScan("unsupported-storage", f"{where} is compressed by {method}; use deflate or no compression")
    needed = math.prod(page.shape) * itemsize
    ends = [offset + count for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True)]
    if max(ends, default=0) > size_bytes or (page.compression == UNCOMPRESSED and sum(page.databytecounts) < needed):
        raise UnreadableScan(
            "truncated-file", f"{where} declares more data than the file of {size_bytes} bytes holds; export it again"
        )
    pieces = sum(count > 0 for count in page.databytecounts)
    if pieces < math.prod(page.chunked):
        raise UnreadableScan(
            "truncated-file",
            f"{where} has {pieces} of its {math.prod(page.chunked)} strips or tiles; export the file again",
        )
    if math.prod(page.chunks) > max(USUAL_TILE_PIXELS, MOST_TILE_PAGES * math.prod(page.shape)):
        raise UnreadableScan(
            "too-large",
            f"{where} has the shape {page.shape} and tiles of {page.chunks}; a tile may have at most {MOST_TILE_PAGES} "
            f"times the pixels of its page, or {USUAL_TILE_PIXELS}: store the pages in smaller tiles or in strips",
        )
    if page.compression != UNCOMPRESSED:
        what = f"a strip or tile of {where}"
        arrays.check_size(what, page.chunks, itemsize, stored_bytes=size_bytes, max_bytes=most_bytes)
        declared = math.prod(page.chunks) * itemsize
        if PACKINGS[int(page.compression)] is arrays.PACKBITS and declared * arrays.PACKBITS_MEMORY > most_bytes:
            raise UnreadableScan(
                "too-large",
                f"{what} needs {declared * arrays.PACKBITS_MEMORY} bytes while PackBits is unpacked and at most "
                f"{most_bytes} are allowed or free; use deflate or no compression",
            )
        arrays.check_packed(what, max(page.databytecounts, default=0), declared)


def _check_unpacked(page: "tifffile.TiffPage | tifffile.TiffFrame", what: str) -> None:
    """Refuse a page with a strip or tile that unpacks to more than it declares; the library keeps all of it."""
    packing = PACKINGS.get(int(page.compression))
    if packing is None or page.dtype is None:
        return
    declared = math.prod(page.chunks) * page.dtype.itemsize
    for offset, stored in zip(page.dataoffsets, page.databytecounts, strict=True):
        if not packing.harmless(stored):
            page.parent.filehandle.seek(offset)
            arrays.check_unpacks(what, packing, page.parent.filehandle.read(stored), declared)


MOST_PAGES = 100_000
# Bytes of one value, by its type's number.
VALUE_BYTES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8], np.float64)


def check_chain(tiff: "tifffile.TiffFile", name: str, size_bytes: int) -> None:
    """Refuse pages that are too many, incomplete or share data: `wrong-shape`, `truncated-file`, `too-large`."""
    layout, stream = tiff.tiff, tiff.filehandle
    width = layout.offsetsize
    tag = np.dtype([("what", "u2"), ("type", "u2"), ("count", f"u{width}"), ("at", f"V{width}")])
    at, pages, claimed = tiff.pages[0].offset, 0, 0.0
    while at:
        pages += 1
        if pages > MOST_PAGES:
            raise UnreadableScan(
                "wrong-shape", f"{name} has more than {MOST_PAGES} pages; a scan has one for each view"
            )
        stream.seek(at)
        # The library stops without an error where the chain leads beyond the end of a truncated file.
        (tags,) = struct.unpack(layout.tagnoformat, _whole(stream, layout.tagnosize, name))
        claimed += tags * tag.itemsize
        _check_claimed(claimed, size_bytes, pages, name)
        stored = np.frombuffer(_whole(stream, tags * tag.itemsize, name), tag.newbyteorder(layout.byteorder))
        # Values that do not fit into their tags are stored elsewhere.
        sizes = VALUE_BYTES[np.minimum(stored["type"], len(VALUE_BYTES) - 1)] * stored["count"]
        claimed += float(sizes[sizes > width].sum())
        _check_claimed(claimed, size_bytes, pages, name)
        (at,) = struct.unpack(layout.offsetformat, _whole(stream, width, name))


def _whole(stream: "tifffile.FileHandle", length: int, name: str) -> bytes:
    data: bytes = stream.read(length)
    if len(data) < length:
        raise UnreadableScan("truncated-file", f"{name} ends before its last page; export it again")
    return data


def _check_claimed(claimed: float, size_bytes: int, pages: int, name: str) -> None:
    if claimed > size_bytes:
        raise UnreadableScan(
            "too-large",
            f"the tags of pages 0 to {pages - 1} of {name} claim {claimed:.0f} bytes of its {size_bytes}: it is "
            "damaged or they share their values; export it again",
        )
