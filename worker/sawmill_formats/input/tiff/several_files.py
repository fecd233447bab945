"""Several TIFF files, of one or more views each, as one stack: from an archive or from a folder."""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_formats.input.arrays import Bounds, check_size
from sawmill_formats.input.contents import Projections
from sawmill_formats.input.tiff.pages import TiffPages

TIFF_SUFFIXES = frozenset({".tif", ".tiff"})
# Views of which one has less than this share of the rows of another are not views of one log.
LEAST_SHARE = 0.5


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


def is_tiff(name: str) -> bool:
    """Return whether a file's name is a TIFF's, and not hidden."""
    path = PurePosixPath(name)
    # macOS packs a hidden twin with each file.
    return path.suffix.lower() in TIFF_SUFFIXES and not path.name.startswith(".") and "__MACOSX" not in path.parts


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort view-2 before view-10."""
    return [
        (0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name.lower()) if part
    ]


def image_kind(name: str) -> str:
    """Return `flat` or `dark` where the name of the file or its folder is that word or begins with it, else `view`."""
    for part in PurePosixPath(name.lower()).parts:
        for kind in ("flat", "dark"):
            if part.startswith(kind):
                return kind
    return "view"


def checked_files(
    what: str, files: Sequence[TiffFile], bounds: Bounds, *, rows_missing: bool = False
) -> list[CheckedTiff]:
    """Check each file's pages, all of one size; views may lack rows.

    Raises
    ------
    UnreadableScan
        A file cannot be read, or is of another size.
    """
    checked: list[CheckedTiff] = []
    before = 0
    for file in files:
        with file.opened(replace(bounds, array=bounds.array - before)) as pages:
            member = CheckedTiff(file, pages.shape)
        _check_like(member, (checked or [member])[0], rows_missing=rows_missing)
        checked.append(member)
        before += 4 * math.prod(member.shape)
    stored = sum(file.stored_bytes for file in files)
    check_size(what, (before // 4,), 4, stored_bytes=stored, max_bytes=bounds.array)
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


def stacked(files: Sequence[CheckedTiff], rows: int, bounds: Bounds) -> Projections:
    """Stack all pages of the files; pages with fewer rows are filled with NaN at their end."""
    ends = np.cumsum([member.shape[0] for member in files])
    cells = files[0].shape[2]

    def read(views: slice, rows_of_views: slice) -> NDArray[np.float32]:
        block = np.full((views.stop - views.start, rows_of_views.stop - rows_of_views.start, cells), np.nan, np.float32)
        for member, end in zip(files, ends.tolist(), strict=True):
            first = end - member.shape[0]
            start, stop, end_row = (
                max(first, views.start),
                min(end, views.stop),
                min(rows_of_views.stop, member.shape[1]),
            )
            if start < stop and rows_of_views.start < end_row:
                with member.file.opened(bounds) as pages:
                    part = pages.read(slice(start - first, stop - first), slice(rows_of_views.start, end_row))
                block[start - views.start : stop - views.start, : end_row - rows_of_views.start] = part
        return block

    return Projections((int(ends[-1]), rows, cells), read, (max(member.shape[0] for member in files), rows))
