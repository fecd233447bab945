"""Flat and dark fields in files of their own, next to the file of the scan."""

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.recognising import recognise
from sawmill_formats.input.wanted import FieldKind, Wanted


def with_fields(contents: FileContents, flats: Path | None, darks: Path | None, bounds: Bounds) -> FileContents:
    """Return the contents of a scan's file with the fields of other files.

    Raises
    ------
    UnreadableScan
        `contradiction` where the scan's file has its own; or the file of the fields cannot be read as such.
    """
    own = _Fields(contents.flats), _Fields(contents.darks)
    of_flats = _either(own[0], flats, FieldKind.FLATS, bounds.whole)
    of_darks = _either(own[1], darks, FieldKind.DARKS, bounds.whole)
    files = (*contents.others, *of_flats.files, *of_darks.files)
    return replace(contents, flats=of_flats.images, darks=of_darks.images, others=files)


@dataclass(frozen=True, eq=False)
class _Fields:
    """Fields (n, rows, detector) or, for one image, (rows, detector); without rows for sinograms; and their files."""

    images: NDArray[np.float32] | None
    files: tuple[Path, ...] = ()


def _either(in_file: _Fields, path: Path | None, kind: FieldKind, bounds: Bounds) -> _Fields:
    if path is None:
        return in_file
    if in_file.images is not None:
        raise UnreadableScan(
            "contradiction",
            f"the file carries {kind} of its own and {quoted(path.name)!r} was given for them (--{kind}); leave one "
            "of them out",
        )
    return _read(path, kind, bounds)


def _read(path: Path, kind: FieldKind, bounds: Bounds) -> _Fields:
    try:
        recognised = recognise(path)
        with ExitStack() as files, library_errors_translated(recognised.name):
            contents = recognised.read(path, Wanted(fields=kind), bounds, files)
            return _Fields(_images_of(contents, kind, bounds), contents.others or (path,))
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
