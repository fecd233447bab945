"""From detector counts to line integrals: flat and dark fields and the Beer-Lambert law."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worker.tomography.preparing.bridging import bridge

Stack = NDArray[np.float32]

# A transmission below this is no measurement but a starved detector: the line integral is cut off here (13.8).
LEAST_TRANSMISSION = 1e-6
# More dead cells than this share of the detector cannot be bridged from their neighbours.
MOST_DEAD = 0.2
# Rows are converted so many bytes at a time, which is all that is needed beside the stack.
BLOCK_BYTES = 16 * 2**20


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


def line_integrals(counts: Stack, flats: Stack, darks: Stack | None, *, out: Stack | None = None) -> LineIntegrals:
    """Line integrals of counts (views, rows, detector) with flats and darks (frames, rows, detector).

    Cells whose flat is not above their dark are dead and are bridged from their neighbours along the detector;
    starved samples (counts at or below the dark) are cut off at the least transmission. Both are remarked.
    Missing samples, NaN, stay missing. `out` is where the line integrals go, by default an array of their own; the
    counts themselves may be named, and are then overwritten.

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
    stack = np.empty(counts.shape, np.float32) if out is None else out
    starved = 0
    for rows in _blocks(counts.shape):
        np.subtract(counts[:, rows], dark[rows].astype(np.float32), out=stack[:, rows])
        starved += _to_line_integrals(stack[:, rows], level[rows], dead[rows])
    if starved:
        remarks.append(f"{starved} samples without signal cut off at a line integral of 13.8")
    if dead.any():
        _bridge(stack, dead)
        remarks.append(f"{int(dead.sum())} dead detector cells bridged from their neighbours")
    return LineIntegrals(stack, np.where(dead, 0.0, air).astype(np.float32), tuple(remarks))


def _blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    views, rows, cells = shape
    step = math.ceil(BLOCK_BYTES / (4 * views * cells))
    return (slice(first, first + step) for first in range(0, rows, step))


def _to_line_integrals(signal: Stack, level: Stack, dead: NDArray[np.bool_]) -> int:
    """Signals (views, rows, detector) to line integrals, in place; answers how many samples were starved."""
    signal /= level
    starved = int(np.count_nonzero((signal < LEAST_TRANSMISSION) & ~dead))
    np.maximum(signal, LEAST_TRANSMISSION, out=signal)
    np.log(signal, out=signal)
    np.negative(signal, out=signal)
    return starved


def _bridge(stack: Stack, dead: NDArray[np.bool_]) -> None:
    """Bridge each row's dead cells, in place."""
    for row in np.flatnonzero(dead.any(axis=1)):
        if dead[row].all():
            raise CountsError(f"every cell of detector row {row} is dead: leave the row out")
        bridge(stack[:, row], dead[row])
