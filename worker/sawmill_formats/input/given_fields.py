"""Flat and dark fields in files of their own, next to the file of the scan, and fields that depart from the others."""

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FieldKind, FileContents, Wanted
from sawmill_formats.input.recognising import recognise
from sawmill_vocabulary.messages import Reason, numbered
from sawmill_vocabulary.reading_messages import ReadingMessage


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
    return contents.projections.read(slice(0, shape[0]), slice(0, shape[1] if len(shape) == 3 else 1)).reshape(shape)


Fields = NDArray[np.float32]

# Fields are compared by their means in this number of parts of the detector. A field is odd if a part departs from the
# median field by this share of the air's level: tubes drift by some per cent, dark levels by less than a hundredth.
PARTS, ODD_FLAT, ODD_DARK = 16, 0.2, 0.02
# If a larger share departs, it is not clear which fields are odd.
MOST_ODD = 0.34


def without_odd_fields(flats: Fields, darks: Fields | None) -> tuple[Fields, Fields | None, tuple[Reason, ...]]:
    """Leave out flats and darks (n, rows, detector) that depart from the others, and return remarks on them."""
    air = np.median(_levels(flats), axis=0)
    kept_flats, of_flats = _kept(flats, ODD_FLAT * air, ReadingMessage.FLATS_LEFT_OUT, ReadingMessage.FLATS_DIFFER)
    if darks is None or not len(darks):
        return kept_flats, darks, of_flats
    kept_darks, of_darks = _kept(darks, ODD_DARK * air, ReadingMessage.DARKS_LEFT_OUT, ReadingMessage.DARKS_DIFFER)
    return kept_flats, kept_darks, (*of_flats, *of_darks)


def _levels(fields: Fields) -> NDArray[np.float64]:
    """Compute the means (n, parts) of the parts of each field."""
    profiles = fields.mean(axis=1, dtype=np.float64)
    parts = min(PARTS, profiles.shape[1])
    starts = np.arange(parts) * profiles.shape[1] // parts
    return np.asarray(np.add.reduceat(profiles, starts, axis=1) / np.diff(starts, append=profiles.shape[1]))


def _kept(
    fields: Fields, allowed: NDArray[np.float64], left_out: ReadingMessage, differ: ReadingMessage
) -> tuple[Fields, tuple[Reason, ...]]:
    """Return the fields within the allowed departure (parts,) from the median field, and a remark on the others."""
    levels = _levels(fields)
    odd = (np.abs(levels - np.median(levels, axis=0)) > allowed).any(axis=1)
    if not odd.any():
        return fields, ()
    if odd.sum() > MOST_ODD * len(fields):
        return fields, (differ(fields=len(fields)),)
    numbers = numbered(np.flatnonzero(odd).tolist())
    return fields[~odd], (left_out(numbers=numbers, odd=int(odd.sum()), fields=len(fields)),)
