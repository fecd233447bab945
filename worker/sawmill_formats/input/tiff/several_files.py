"""Several TIFF files, of one or more views each, as one stack: from an archive or from a folder."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import IO

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds, check_size
from sawmill_formats.input.contents import FieldKind, FileContents, Part, PartKind, Projections, Wanted
from sawmill_formats.input.image_names import listed, natural_key, sorted_images
from sawmill_formats.input.tiff.pages import TiffPages, open_pages, opened_tiff, page_type, stated_scaling
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
            text = stream.read(LONGEST_SCALE_FILE).decode("ascii", "replace")
        stated, name = dict(re.findall(r'"(scale|offset)":\s*([^\s,}]+)', text)), quoted(scale_file)
        scaling = stated_scaling(repr(name), name, stated.get("scale", ""), stated.get("offset", ""), inverse=True)
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
        checked.append(member)
        (_, rows, cells), (_, rows_before, cells_before) = member.shape, checked[0].shape
        low, high = sorted((rows, rows_before))
        if cells != cells_before or not (low == high or (rows_missing and LEAST_SHARE * high <= low)):
            raise UnreadableScan(
                "wrong-shape",
                f"{quoted(file.name)!r} has (rows, detector) = {member.shape[1:]} and the files before it "
                f"{checked[0].shape[1:]}; all must be of one size",
            )
        before += 4 * math.prod(member.shape)
    check_size(what, (before // 4,), 4, stored_bytes=sum(file.stored_bytes for file in files), max_bytes=bounds.array)
    return checked


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


MOST_FILES = 100_000


def read_folder(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the TIFF files of a folder, each opened when its views are read. Subfolders are not read."""
    if selection.dataset is not None:
        raise UnreadableScan("contradiction", f"a folder has no named arrays; leave out {quoted(selection.dataset)!r}")
    members = [each for each in entries(path) if not (selection.apart and each.resolve() in selection.apart)]
    images = [each for each in members if _is_image(each)]
    if not images:
        raise UnreadableScan("unknown-format", "the folder holds no TIFF files; give the folder that holds the views")
    folders = [each.name for each in members if each.is_dir()]
    others = [each.name for each in members if not (_is_image(each) or each.is_dir())]
    files = [TiffFile(each.name, _size(each), partial(_opened, each)) for each in images]
    contents = read_files(
        "folder-of-tiffs", files, others, lambda name: (path / name).open("rb"), selection, bounds, rows_missing=False
    )
    subfolders = [ReadingMessage.SUBFOLDERS(folders=len(folders), names=listed(folders))] if folders else []
    return replace(contents, remarks=(*subfolders, *contents.remarks), others=tuple(images))


def folder_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Yield the files and subfolders, TIFF files with the properties of their first pages."""
    for each in entries(path):
        name = quoted(each.name)
        if each.is_dir():
            yield Part(name, PartKind.GROUP, type="folder")
        elif _is_image(each):
            with library_errors_translated(repr(name)), opened_tiff(each, repr(name), _size(each)) as tiff:
                first, pages = tiff.pages[0], len(tiff.pages)
                shape = first.shape if pages == 1 else (pages, *first.shape)
                number_type, compression = page_type(first)
            yield Part(name, PartKind.FILE, shape, number_type, stored_bytes=_size(each), compression=compression)
        else:
            yield Part(name, PartKind.FILE, type=quoted(each.suffix.lstrip(".")) or None, stored_bytes=_size(each))


def entries(path: Path) -> list[Path]:
    """List everything in a folder, view-2 before view-10: `too-large` for more files than are read."""
    members = list(islice(path.iterdir(), MOST_FILES + 1))
    if len(members) > MOST_FILES:
        raise UnreadableScan("too-large", f"the folder holds more than {MOST_FILES} files; give one of views alone")
    return sorted(members, key=lambda each: natural_key(each.name))


def _is_image(path: Path) -> bool:
    return is_tiff(path.name) and path.is_file()


def _size(path: Path) -> int:
    """Return the size in bytes; 0 for a link to no file, which is refused later."""
    return path.stat().st_size if path.exists() else 0


@contextmanager
def _opened(path: Path, bounds: Bounds) -> Iterator[TiffPages]:
    name = repr(quoted(path.name))
    with library_errors_translated(name), open_pages(path, name, _size(path), bounds) as pages:
        yield pages
