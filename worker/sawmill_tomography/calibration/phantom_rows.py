"""Rows of a stack that show the phantom, and rows that show another body; a jump separates two bodies."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# A step from row to row is a jump when it is this many times the usual step, and this share of the shadow itself.
JUMP, JUMP_SHARE = 4.0, 0.1
# For the comparison, rows are averaged over cells and taken at this number of views: jumps are coarse.
VIEWS, CELLS = 60, 64
# A row with less than the share LEAST_SHADOW of the phantom's shadow shows air; a row whose correlation with a row of
# the phantom is above SAME_BODY shows the phantom.
LEAST_SHADOW, SAME_BODY = 0.25, 0.99
# Among fewer rows it is not known which of two bodies is the odd one.
FEWEST_ROWS = 3


def segments(stack: NDArray[np.floating]) -> list[slice]:
    """Find runs of rows without a jump between two rows, longest first.

    Parameters
    ----------
    stack : (views, rows, detector) float
        Line integrals; NaN in rows that a view lacks. A phantom is the same in all its rows; where it ends, everything
        changes at once.
    """
    coarse = _coarse(stack)
    steps = np.sqrt(np.nanmean((coarse[1:] - coarse[:-1]) ** 2, axis=1))
    depth = float(np.median(np.nanstd(coarse, axis=1)))
    usual = float(np.median(steps)) if steps.size else 0.0
    jumps = np.flatnonzero(steps > max(JUMP * usual, JUMP_SHARE * depth)) + 1
    edges = [0, *jumps.tolist(), stack.shape[1]]
    runs = [slice(first, last) for first, last in pairwise(edges)]
    return sorted(runs, key=lambda run: run.start - run.stop)


def shows_another_body(sinogram: FloatArray, phantom: FloatArray) -> bool:
    """Return whether a row shows neither air nor the phantom; False for a row with values that are not finite."""
    if not np.isfinite(sinogram).all() or sinogram.std() < LEAST_SHADOW * phantom.std():
        return False
    return float(np.corrcoef(sinogram.ravel(), phantom.ravel())[0, 1]) < SAME_BODY


def odd_rows(stack: NDArray[np.floating]) -> list[int]:
    """Return the rows of a stack (views, rows, detector) that show another body than most rows do."""
    coarse = _coarse(stack)
    usual = np.nanmedian(coarse, axis=0)
    seen = np.isfinite(coarse).all(axis=0)
    if len(coarse) < FEWEST_ROWS or not seen.any():
        return []
    return [row for row, values in enumerate(coarse[:, seen]) if not _same_body(values, usual[seen])]


def _same_body(values: FloatArray, usual: FloatArray) -> bool:
    spread = values.std()
    return bool(spread > 0.0) and float(np.corrcoef(values, usual)[0, 1]) >= SAME_BODY


def _coarse(stack: NDArray[np.floating]) -> FloatArray:
    """Take views at regular intervals and average cells: (rows, samples)."""
    views, rows, cells = stack.shape
    binned = max(1, cells // CELLS)
    some = np.asarray(stack[:: max(1, views // VIEWS), :, : cells // binned * binned], np.float64)
    return np.asarray(some.reshape(len(some), rows, -1, binned).mean(axis=3).transpose(1, 0, 2).reshape(rows, -1))
