"""Rows of a stack that show the phantom, and rows that show another body; a jump separates two bodies."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.calibration.search.misfit import COARSE_CELLS, COARSE_VIEWS
from sawmill_tomography.geometry.geometry import FloatArray

# A step from row to row is a jump when it is this many times the usual step, and leads to another body.
JUMP = 4.0
# A row with less than the share LEAST_SHADOW of the phantom's shadow shows air; a row whose correlation with a row of
# the phantom is above SAME_BODY shows the phantom.
LEAST_SHADOW, SAME_BODY = 0.25, 0.99


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
    jumps = np.flatnonzero(steps > max(JUMP * usual, math.sqrt(2.0 * (1.0 - SAME_BODY)) * depth)) + 1
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
    if not seen.any():
        return []
    # A row without contrast correlates with none.
    alike = [float(np.corrcoef(values, usual[seen])[0, 1]) if values.std() > 0.0 else 0.0 for values in coarse[:, seen]]
    odd = [row for row, each in enumerate(alike) if not each >= SAME_BODY]
    return odd if 2 * len(odd) < len(coarse) else []  # of two rows, neither is the odd one


def _coarse(stack: NDArray[np.floating]) -> FloatArray:
    """Take views at regular intervals and average cells: (rows, samples)."""
    views, rows, cells = stack.shape
    binned = max(1, cells // COARSE_CELLS)
    some = np.asarray(stack[:: max(1, views // COARSE_VIEWS), :, : cells // binned * binned], np.float64)
    return np.asarray(some.reshape(len(some), rows, -1, binned).mean(axis=3).transpose(1, 0, 2).reshape(rows, -1))
