"""From detector counts to line integrals: flat and dark fields and the Beer-Lambert law."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worker.tomography.bridging import bridge

Stack = NDArray[np.float32]

# A transmission below this is no measurement but a starved detector: the line integral is cut off here (13.8).
LEAST_TRANSMISSION = 1e-6
# More dead cells than this share of the detector cannot be bridged from their neighbours.
MOST_DEAD = 0.2


class CountsError(ValueError):
    """Counts that cannot become line integrals; the message says why."""


@dataclass(frozen=True)
class LineIntegrals:
    """A stack of line integrals.

    Attributes
    ----------
    stack : (views, rows, detector) float32
        -ln((counts - dark) / (flat - dark)), dimensionless.
    air_level : (rows, detector) float32
        Mean flat minus mean dark, in counts: with it the counts, and so their noise, can be recovered.
    remarks : tuple of str
        What was done beside the formula.
    """

    stack: Stack
    air_level: Stack
    remarks: tuple[str, ...]


def line_integrals(counts: Stack, flats: Stack, darks: Stack | None) -> LineIntegrals:
    """Line integrals of counts (views, rows, detector) with flats and darks (frames, rows, detector).

    Cells whose flat is not above their dark are dead and are bridged from their neighbours along the detector;
    starved samples (counts at or below the dark) are cut off at the least transmission. Both are remarked.
    Missing samples, NaN, stay missing.

    Raises
    ------
    CountsError
        If too many cells are dead.
    """
    dark = np.zeros(counts.shape[1:]) if darks is None else darks.mean(axis=0, dtype=np.float64)
    air = flats.mean(axis=0, dtype=np.float64) - dark
    dead = air <= 0.0
    if dead.mean() > MOST_DEAD:
        raise CountsError(
            f"{int(dead.sum())} of {dead.size} detector cells have a flat field that is not above their dark field: "
            "check that flats and darks were not exchanged"
        )
    remarks = ["counts to line integrals by -ln((counts - dark) / (flat - dark))"]
    level = np.where(dead, 1.0, air).astype(np.float32)
    stack: Stack = np.asarray(counts - dark.astype(np.float32), np.float32)
    stack /= level
    starved = (stack < LEAST_TRANSMISSION) & ~dead
    np.maximum(stack, LEAST_TRANSMISSION, out=stack)
    np.log(stack, out=stack)
    np.negative(stack, out=stack)
    if starved.any():
        remarks.append(f"{int(starved.sum())} samples without signal cut off at a line integral of 13.8")
    if dead.any():
        _bridge(stack, dead)
        remarks.append(f"{int(dead.sum())} dead detector cells bridged from their neighbours")
    return LineIntegrals(stack, np.where(dead, 0.0, air).astype(np.float32), tuple(remarks))


def _bridge(stack: Stack, dead: NDArray[np.bool_]) -> None:
    """Bridge each row's dead cells, in place."""
    for row in np.flatnonzero(dead.any(axis=1)):
        if dead[row].all():
            raise CountsError(f"every cell of detector row {row} is dead: leave the row out")
        bridge(stack[:, row], dead[row])
