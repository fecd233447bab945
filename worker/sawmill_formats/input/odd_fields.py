"""Flat and dark fields that depart from the others, such as a dark field that was taken with the beam on."""

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary.messages import Reason, numbered
from sawmill_vocabulary.reading_messages import ReadingMessage

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
