"""A folder of TIFF files, one or more views each, as a scanner or a camera leaves them on a disk."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import islice, pairwise
from pathlib import Path

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.parts import Part, PartKind, form_of
from sawmill_formats.input.tiff.pages import TiffPages, open_pages, opened_tiff, page_type
from sawmill_formats.input.tiff.several_files import (
    TiffFile,
    checked_files,
    image_kind,
    is_tiff,
    natural_key,
    stacked,
)
from sawmill_formats.input.wanted import Wanted
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

MOST_FILES = 100_000
MOST_QUOTED = 10


def read_folder(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the TIFF files of a folder in natural order, each opened when its views are read.

    Nothing is guessed from names: fields are in another folder or file. Subfolders are not read.

    Raises
    ------
    UnreadableScan
        When there are no TIFF files, some are named flat or dark fields and others not, or one cannot
        be read or is of another size.
    """
    if selection.dataset is not None:
        raise UnreadableScan("contradiction", f"a folder has no named arrays; leave out {quoted(selection.dataset)!r}")
    members = entries(path)
    paths = [each for each in members if _is_image(each)]
    if not paths:
        raise UnreadableScan("unknown-format", "the folder holds no TIFF files; give the folder that holds the views")
    _check_kinds(paths)
    checked = checked_files("the folder", [_file(each) for each in paths], bounds)
    names = [each.name for each in paths]
    remarks = (*_ignored(members, paths), *_forms(names), *_gaps(names))
    projections = stacked(checked, checked[0].shape[1], bounds)
    return FileContents("folder-of-tiffs", projections, remarks=remarks, others=tuple(paths))


def folder_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Yield the files and subfolders, TIFF files with the properties of their first pages."""
    for each in entries(path):
        name = quoted(each.name)
        if each.is_dir():
            yield Part(name, PartKind.GROUP, type="folder")
        elif _is_image(each):
            yield _image_part(each, name)
        else:
            yield Part(name, PartKind.FILE, type=quoted(each.suffix.lstrip(".")) or None, stored_bytes=_size(each))


def entries(path: Path) -> list[Path]:
    """List everything in a folder, view-2 before view-10.

    Raises
    ------
    UnreadableScan
        `too-large` for more files than are read.
    """
    members = list(islice(path.iterdir(), MOST_FILES + 1))
    if len(members) > MOST_FILES:
        raise UnreadableScan("too-large", f"the folder holds more than {MOST_FILES} files; give one of views alone")
    return sorted(members, key=lambda each: natural_key(each.name))


def _is_image(path: Path) -> bool:
    return is_tiff(path.name) and path.is_file()


def _size(path: Path) -> int:
    """Return the size in bytes; 0 for a link to no file, which is refused later."""
    return path.stat().st_size if path.exists() else 0


def _file(path: Path) -> TiffFile:
    return TiffFile(path.name, _size(path), partial(_opened, path))


@contextmanager
def _opened(path: Path, bounds: Bounds) -> Iterator[TiffPages]:
    name = repr(quoted(path.name))
    with library_errors_translated(name), open_pages(path, name, _size(path), bounds) as pages:
        yield pages


def _image_part(path: Path, name: str) -> Part:
    with library_errors_translated(repr(name)), opened_tiff(path, repr(name), _size(path)) as tiff:
        first, pages = tiff.pages[0], len(tiff.pages)
        shape = first.shape if pages == 1 else (pages, *first.shape)
        number_type, compression = page_type(first)
    return Part(name, PartKind.FILE, shape, number_type, stored_bytes=_size(path), compression=compression)


def _check_kinds(paths: Sequence[Path]) -> None:
    """Refuse a mixture of views and files that may be fields."""
    kinds = [image_kind(each.name) for each in paths]
    if len(set(kinds)) > 1:
        other = next(each.name for each, kind in zip(paths, kinds, strict=True) if kind != "view")
        raise UnreadableScan(
            "contradiction",
            f"the folder holds {quoted(other)!r} beside files that are not so called; put flat and dark fields into "
            "folders of their own, and give these by --flats and --darks",
        )


def _ignored(members: Sequence[Path], images: Sequence[Path]) -> Iterator[Reason]:
    rest = set(members) - set(images)
    folders = sum(each.is_dir() for each in rest)
    if folders:
        yield ReadingMessage.SUBFOLDERS(folders=folders)
    if len(rest) > folders:
        yield ReadingMessage.OTHER_FILES(files=len(rest) - folders)


def _forms(names: Sequence[str]) -> Iterator[Reason]:
    forms = list(dict.fromkeys(map(form_of, names)))
    if len(forms) > 1:
        shown = ", ".join(quoted(form) for form in forms[:MOST_QUOTED])
        yield ReadingMessage.NAMES_OF_SEVERAL_FORMS(forms=len(forms), names=shown)


def _gaps(names: Sequence[str]) -> Iterator[Reason]:
    """Find the missing numbers where one number alone distinguishes the names of a sequence."""
    columns = list(zip(*(map(int, re.findall(r"\d+", name)) for name in names), strict=False))
    varying = [sorted(set(column)) for column in columns if len(set(column)) > 1]
    if len(set(map(form_of, names))) > 1 or len(varying) != 1 or len(varying[0]) != len(names):
        return
    numbers = varying[0]
    step = math.gcd(*(after - before for before, after in pairwise(numbers)))
    there = len(range(numbers[0], numbers[-1] + 1, step))
    if there > len(numbers):
        held = set(numbers)
        absent = islice((n for n in range(numbers[0], numbers[-1], step) if n not in held), MOST_QUOTED)
        more = ", ..." if there - len(numbers) > MOST_QUOTED else ""
        left_out = ", ".join(map(str, absent)) + more
        yield ReadingMessage.NUMBERS_LEFT_OUT(numbers=left_out, missing=there - len(numbers), total=there)
