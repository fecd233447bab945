"""Masked rays of a scan's views, bridged by a curve, less the mean error of such curves at the same place elsewhere.

Behind a log a straight line has the same sign of error in every view, and so has a cubic over a bark: this is not
noise.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.present_rows import runs_of

# Rays used on either side of a gap: this share of its width, and no fewer than this number.
BESIDE, FEWEST_BESIDE = 0.25, 4
# Number of other bridges that give a bridge's error. Where other views have fewer at the same cells, bridges next to
# these cells are used too, in all views.
FEWEST_BRIDGES = 5


def bridge_masked(rays: FloatArray, masked: NDArray[np.bool_]) -> FloatArray:
    """Bridge masked rays along the detector, in place, and return the standard deviations of the bridges.

    Parameters
    ----------
    rays : (views, cells) float64
        Line integrals of one body; masked ones are overwritten.
    masked : (views, cells) bool
        True for masked rays; no view is masked as a whole.

    Returns
    -------
    (views, cells) float64
        Standard deviations, 0 where nothing was masked. The errors within a bridge are correlated, and only sums over
        a bridge are needed: the errors of these sums are as large as for independent errors with these deviations.
    """
    measured, deviations = rays.copy(), np.zeros(rays.shape)
    for view, first, length in runs_of(masked):
        last = first + length
        rays[view, first:last], deviations[view, first:last] = _bridged(measured, masked, view, first, last)
    return deviations


def _bridged(rays: FloatArray, masked: NDArray[np.bool_], view: int, first: int, last: int) -> tuple[FloatArray, float]:
    """Return one gap's rays (width,), and their deviation."""
    width = last - first
    reach = max(FEWEST_BESIDE, round(BESIDE * width))
    beside = np.concatenate([np.arange(first - reach, first), np.arange(last, last + reach)])
    beside = beside[(beside >= 0) & (beside < rays.shape[1])]
    beside = beside[~masked[view, beside]]
    if beside.size == 0:
        measured = rays[view, ~masked[view]]
        return np.full(width, np.median(measured)), float(np.ptp(measured))
    # A cubic needs rays on both sides; at an end of the detector, where there is air, the mean of the rays is used.
    degree = min(3, beside.size - 1) if np.any(beside < first) and np.any(beside >= last) else 0
    middle = 0.5 * (first + last - 1)
    powers = np.vander((np.append(beside, np.arange(first, last)) - middle) / width, degree + 1)
    through = powers[beside.size :] @ np.linalg.pinv(powers[: beside.size])
    missed = _missed(rays, masked, through, beside, np.arange(first, last))
    curve = through @ rays[view, beside]
    if len(missed) < 2:
        return curve, float(np.ptp(rays[view, ~masked[view]]))
    deviation = math.sqrt(float(missed.sum(axis=1).var(ddof=1)) * (1.0 + 1.0 / len(missed)) / width)
    # Where few views show those cells, bridges next to them are used, and the errors of all views are correlated.
    alike = int(masked[:, first:last].any(axis=1).sum())
    if len(masked) - alike < FEWEST_BRIDGES:
        deviation *= math.sqrt(alike)
    return curve + missed.mean(axis=0), deviation


def _missed(
    rays: FloatArray, masked: NDArray[np.bool_], through: FloatArray, beside: NDArray[np.intp], gap: NDArray[np.intp]
) -> FloatArray:
    """Return the errors of such curves, (bridges, width), where rays were measured: at those cells, or near them."""
    missed: list[FloatArray] = []
    cells, step = rays.shape[1], max(1, gap.size // 2)
    for away in range(0, cells, step):
        for shift in (away, -away) if away else (0,):
            at, around = gap + shift, beside + shift
            if min(at[0], around[0]) < 0 or max(at[-1], around[-1]) >= cells:
                continue
            whole = ~(masked[:, at].any(axis=1) | masked[:, around].any(axis=1))
            missed.extend(rays[whole][:, at] - rays[whole][:, around] @ through.T)
        if len(missed) >= FEWEST_BRIDGES:
            break
    return np.array(missed)
