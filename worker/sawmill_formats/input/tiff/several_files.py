"""Several TIFF files, of one or more views each, as one stack: from an archive or from a folder."""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import IO

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, Scaling, check_size
from sawmill_formats.input.contents import FileContents, Projections
from sawmill_formats.input.image_names import listed, sorted_images
from sawmill_formats.input.tiff.pages import TiffPages, stated_scaling
from sawmill_formats.input.wanted import FieldKind, Wanted
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

TIFF_SUFFIXES = frozenset({".tif", ".tiff"})
# Views of which one has less than this share of the rows of another are not views of one log.
LEAST_SHARE = 0.5
# The Core Imaging Library writes this file next to images that it packed: value = (stored - offset) / scale.
SCALE_FILE, LONGEST_SCALE_FILE = "scaleoffset.json", 300


@dataclass(frozen=True, eq=False)
class TiffFile:
    """A file of the stack before it is opened: its name, its stored bytes, and the function that opens its pages."""

    name: str
    stored_bytes: int
    opened: Callable[[Bounds], AbstractContextManager[TiffPages]]


@dataclass(frozen=True, eq=False)
class CheckedTiff:
    """A file of the stack, its pages checked."""

    file: TiffFile
    shape: tuple[int, int, int]
    remarks: tuple[Reason, ...]


def is_tiff(name: str) -> bool:
    """Return whether a file's name is a TIFF's, and not hidden."""
    path = PurePosixPath(name)
    # macOS packs a hidden twin with each file.
    return path.suffix.lower() in TIFF_SUFFIXES and not path.name.startswith(".") and "__MACOSX" not in path.parts


def read_files(
    format_name: str,
    images: Sequence[TiffFile],
    others: Sequence[str],
    opened: Callable[[str], IO[bytes]],
    selection: Wanted,
    bounds: Bounds,
    *,
    rows_missing: bool,
) -> FileContents:
    """Read the views of an archive or a folder in the order of their names, and the fields that are called so."""
    what = "the archive" if format_name == "zip-of-tiffs" else "the folder"
    kinds, remarks = sorted_images([image.name for image in images], selection.fields)
    views, flats, darks = ([images[n] for n in kinds[kind]] for kind in (None, *FieldKind))
    if not views:
        raise UnreadableScan(
            "unknown-format",
            f"{what} holds no TIFF files of views, but {len(flats) + len(darks)} of flat and dark fields and "
            f"{len(others)} other files; give the views as .tif files whose names begin neither with flat nor with "
            "dark",
        )
    checked = _checked(what, views, bounds, rows_missing=rows_missing)
    flat_fields, dark_fields = (_fields(what, of_kind, bounds.whole) for of_kind in (flats, darks))
    rows = max(member.shape[1] for member in checked)
    remarks += {remark.message: remark for member in checked for remark in member.remarks}.values()
    if any(member.shape[1] < rows for member in checked):
        rows = max(rows, 0 if flat_fields is None else flat_fields.shape[1])
        remarks.append(ReadingMessage.FEWER_ROWS(rows=rows))
    projections = stacked = _stacked(checked, rows, bounds)
    scale_file = str(PurePosixPath(views[0].name).with_name(SCALE_FILE))
    if scale_file in others:
        with opened(scale_file) as stream:
            scaling = _scaling_of(quoted(scale_file), stream.read(LONGEST_SCALE_FILE).decode("ascii", "replace"))
        projections = replace(projections, read=lambda *parts: scaling.apply(stacked.read(*parts)))
        remarks += scaling.remarks()
    ignored = sorted({*others} - {scale_file})
    if ignored:
        remarks.insert(0, ReadingMessage.OTHER_FILES(files=len(ignored), names=listed(ignored)))
    return FileContents(format_name, projections, flat_fields, dark_fields, remarks=tuple(remarks))


def _checked(what: str, files: Sequence[TiffFile], bounds: Bounds, *, rows_missing: bool = False) -> list[CheckedTiff]:
    """Check each file's pages, all of one size; views may lack rows."""
    checked: list[CheckedTiff] = []
    before = 0
    for file in files:
        with file.opened(replace(bounds, array=bounds.array - before)) as pages:
            member = CheckedTiff(file, pages.shape, pages.remarks)
        _check_like(member, (checked or [member])[0], rows_missing=rows_missing)
        checked.append(member)
        before += 4 * math.prod(member.shape)
    check_size(what, (before // 4,), 4, stored_bytes=sum(file.stored_bytes for file in files), max_bytes=bounds.array)
    return checked


def _check_like(member: CheckedTiff, first: CheckedTiff, *, rows_missing: bool) -> None:
    (_, rows, cells), (_, rows_before, cells_before) = member.shape, first.shape
    alike = rows == rows_before or (rows_missing and LEAST_SHARE * max(rows, rows_before) <= min(rows, rows_before))
    if cells != cells_before or not alike:
        raise UnreadableScan(
            "wrong-shape",
            f"{quoted(member.file.name)!r} has (rows, detector) = {member.shape[1:]} and the files before it "
            f"{first.shape[1:]}; all must be of one size",
        )


def _stacked(files: Sequence[CheckedTiff], rows: int, bounds: Bounds) -> Projections:
    """Stack all pages of the files; pages with fewer rows are filled with NaN at their end."""
    ends = np.cumsum([member.shape[0] for member in files])
    cells = files[0].shape[2]

    def read(views: slice, rows_of_views: slice) -> NDArray[np.float32]:
        block = np.full((views.stop - views.start, rows_of_views.stop - rows_of_views.start, cells), np.nan, np.float32)
        for member, end in zip(files, ends.tolist(), strict=True):
            first = end - member.shape[0]
            start, stop = max(first, views.start), min(end, views.stop)
            end_row = min(rows_of_views.stop, member.shape[1])
            if start < stop and rows_of_views.start < end_row:
                with member.file.opened(bounds) as pages:
                    part = pages.read(slice(start - first, stop - first), slice(rows_of_views.start, end_row))
                block[start - views.start : stop - views.start, : end_row - rows_of_views.start] = part
        return block

    return Projections((int(ends[-1]), rows, cells), read, (max(member.shape[0] for member in files), rows))


def _fields(what: str, files: Sequence[TiffFile], bounds: Bounds) -> NDArray[np.float32] | None:
    if not files:
        return None
    checked = _checked(what, files, bounds)
    fields = _stacked(checked, checked[0].shape[1], bounds)
    return fields.read(slice(0, fields.shape[0]), slice(0, fields.shape[1]))


def _scaling_of(scale_file: str, text: str) -> Scaling:
    stated = dict(re.findall(r'"(scale|offset)":\s*([^\s,}]+)', text))
    return stated_scaling(repr(scale_file), scale_file, stated.get("scale", ""), stated.get("offset", ""), inverse=True)
