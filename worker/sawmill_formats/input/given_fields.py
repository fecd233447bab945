"""Flat and dark fields in files of their own, next to the file of the scan."""

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.recognising import recognise
from sawmill_formats.input.wanted import FieldKind, Wanted


def with_fields(contents: FileContents, flats: Path | None, darks: Path | None, bounds: Bounds) -> FileContents:
    """Return a scan's contents with the fields of other files: `contradiction` if it has such fields."""
    fields = {FieldKind.FLATS: contents.flats, FieldKind.DARKS: contents.darks}
    others = contents.others
    for kind, path in ((FieldKind.FLATS, flats), (FieldKind.DARKS, darks)):
        if path is None:
            continue
        if fields[kind] is not None:
            raise UnreadableScan(
                "contradiction",
                f"the file carries {kind} of its own and {quoted(path.name)!r} was given for them (--{kind}); leave "
                "one of them out",
            )
        fields[kind], files = _read(path, kind, bounds.whole)
        others = (*others, *files)
    return replace(contents, flats=fields[FieldKind.FLATS], darks=fields[FieldKind.DARKS], others=others)


def _read(path: Path, kind: FieldKind, bounds: Bounds) -> tuple[NDArray[np.float32], tuple[Path, ...]]:
    """Return the fields (n, rows, detector), or one (rows, detector), without rows for sinograms; and their files."""
    try:
        recognised = recognise(path)
        with ExitStack() as files, library_errors_translated(recognised.name):
            contents = recognised.read(path, Wanted(fields=kind), bounds, files)
            return _images_of(contents, kind, bounds), contents.others or (path,)
    except UnreadableScan as error:
        raise UnreadableScan(error.code, f"--{kind} {quoted(path.name)!r}: {error}") from error


def _images_of(contents: FileContents, kind: FieldKind, bounds: Bounds) -> NDArray[np.float32]:
    """Select the fields that the file states to be of this kind; where it states none, the images that it holds."""
    stated = {FieldKind.FLATS: contents.flats, FieldKind.DARKS: contents.darks}
    fields = stated[kind]
    if fields is not None:
        return fields
    if any(other is not None for other in stated.values()):
        raise UnreadableScan("dataset-missing", f"it holds no {kind}, only other fields; give a file that holds them")
    shape = contents.projections.shape
    needed = 4 * math.prod(shape)
    if needed > bounds.piece:
        raise UnreadableScan(
            "too-large", f"its images need {needed} bytes and {bounds.piece} are allowed or free; give fewer"
        )
    rows = shape[1] if len(shape) == 3 else 1
    return contents.projections.read(slice(0, shape[0]), slice(0, rows)).reshape(shape)
