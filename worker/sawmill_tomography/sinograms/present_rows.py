"""Stacks whose views lack some rows: the rows present, their means, filling; and faulty cells and masked rays bridged.

Masked rays are bridged by a curve, less the mean error of such curves at the same place elsewhere: behind a log a
straight line has the same sign of error in every view, and so has a cubic over a bark. This is not noise.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import TAU, FloatArray

Rows = NDArray[np.bool_]

# A row is used if at least this share of the views has it, and if they leave no gap beyond this number of the
# scan's median steps, or this angle. With a third fewer views, missing at random, the error of an FBP slice of a log is
# 1.1 (360 views) to 1.3 times (60 views) the error of the complete scan (benchmarks/lost_rows.py at 3ab7f653).
ENOUGH, WIDEST_STEPS, WIDEST_RAD = 0.5, 5.0, math.radians(60.0)


class MeanOfRows(NamedTuple):
    """The mean over rows, for the views that have any row."""

    sinogram: FloatArray  # (views, detector)
    views: NDArray[np.intp]  # (views,) integers: numbers of these views in the stack


def present_rows(stack: NDArray[np.floating]) -> Rows:
    """Return which rows (..., rows) of images (..., rows, cells) are present: a missing row is NaN in every cell."""
    return np.asarray(~np.isnan(stack[..., 0]))


def mean_of_rows(stack: NDArray[np.floating]) -> MeanOfRows:
    """Average each view over those rows of a stack (views, rows, detector) that it has.

    This is right if all rows show the same, as a phantom's do: views may average different rows.
    """
    there = present_rows(stack)
    if there.all():
        return MeanOfRows(stack.mean(axis=1, dtype=np.float64), np.arange(len(stack)))
    views = np.flatnonzero(there.any(axis=1))
    sums: FloatArray = np.nansum(stack[views], axis=1, dtype=np.float64)
    return MeanOfRows(sums / there[views].sum(axis=1, keepdims=True), views)


def usable_rows(present: Rows, angles_rad: FloatArray) -> tuple[int, int] | None:
    """Return the rows, first and one after the last, that half of the views have without a wide gap in angle.

    Parameters
    ----------
    present : (views, rows) bool

    Returns
    -------
    The longest run of such rows; None if there is none.
    """
    steps = _gaps(angles_rad)
    widest = max(float(steps.max()), WIDEST_STEPS * float(np.median(steps)), WIDEST_RAD) * (1.0 + 1e-9)
    enough = np.array(
        [there.sum() >= ENOUGH * there.size and float(_gaps(angles_rad[there]).max()) <= widest for there in present.T]
    )
    runs = [run for run in _runs(enough[:, None]) if enough[run.start]]
    longest = max(runs, key=lambda run: run.stop - run.start, default=None)
    return None if longest is None else (longest.start, longest.stop)


def filled(stack: NDArray[np.float32], angles_rad: FloatArray) -> NDArray[np.float32]:
    """Interpolate missing rows of a stack (views, rows, detector) between the two views nearest in angle.

    For methods that need views at equal steps: weighting the views next to a gap by its width instead is the same as
    the nearest view, and leaves up to 2.5 times the error (benchmarks/lost_rows.py at 3ab7f653).
    """
    there = present_rows(stack)
    if there.all():
        return stack
    out = stack.copy()
    for run in _runs(there.T):
        views = there[:, run.start]
        if not views.all():
            below, above, share = _neighbours(angles_rad, views)
            out[~views, run] = (1.0 - share) * stack[below, run] + share * stack[above, run]
    return out


def _neighbours(angles_rad: FloatArray, there: Rows) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Return, for each missing view, the views before and after it, and its position between them (n, 1, 1)."""
    direction, present = np.mod(angles_rad, TAU), np.flatnonzero(there)
    present = present[np.argsort(direction[present], kind="stable")]
    after = np.searchsorted(direction[present], direction[~there])
    below, above = present[after - 1], present[after % present.size]
    gap = np.mod(direction[above] - direction[below], TAU)
    share = np.mod(direction[~there] - direction[below], TAU) / np.where(gap > 0.0, gap, 1.0)
    return below, above, share.astype(np.float32)[:, None, None]


def _gaps(angles_rad: FloatArray) -> FloatArray:
    """Return the gaps from each direction to the next, over the full turn."""
    directions = np.sort(np.mod(angles_rad, TAU))
    return np.diff(directions, append=directions[:1] + TAU)


def _runs(keys: Rows) -> list[slice]:
    """Return runs of equal keys (n, length)."""
    changes = np.flatnonzero((keys[1:] != keys[:-1]).any(axis=1)) + 1
    return [slice(first, last) for first, last in pairwise([0, *changes.tolist(), len(keys)])]


# The view, the first cell and the number of neighbouring samples of a view.
Run = tuple[int, int, int]


def runs_of(left_out: NDArray[np.bool_]) -> list[Run]:
    """Return the runs of samples that are left out, (views, cells), by view."""
    edges = np.diff(left_out.astype(np.int8), axis=1, prepend=0, append=0)
    (view, first), (_, end) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    return list(zip(view.tolist(), first.tolist(), (end - first).tolist(), strict=True))


def bridge(sinogram: NDArray[np.floating], faulty: NDArray[np.bool_]) -> None:
    """Replace faulty cells by linear interpolation along the detector, in place; at an end by the nearest good one.

    `sinogram` (views, cells). `faulty` (cells,) bool: True for faulty cells, at least one False.
    """
    good, bad = np.flatnonzero(~faulty), np.flatnonzero(faulty)
    right = np.clip(np.searchsorted(good, bad), 1, max(good.size - 1, 1))
    low, high = good[right - 1], good[np.minimum(right, good.size - 1)]
    share = np.clip((bad - low) / np.maximum(high - low, 1), 0.0, 1.0).astype(sinogram.dtype)
    sinogram[:, bad] = (1.0 - share) * sinogram[:, low] + share * sinogram[:, high]


def bridged_samples(sinogram: NDArray[np.floating], left_out: NDArray[np.bool_]) -> NDArray[np.floating]:
    """Return a copy in which samples are interpolated linearly along the detector; at an end, the nearest good one.

    `sinogram` (..., cells). `left_out` (..., cells) bool: True for samples to interpolate. A row that is left out as a
    whole stays as it is.
    """
    cells = sinogram.shape[-1]
    at = np.broadcast_to(np.arange(cells), sinogram.shape)
    low = np.maximum.accumulate(np.where(left_out, -1, at), axis=-1)
    high = np.minimum.accumulate(np.where(left_out, cells, at)[..., ::-1], axis=-1)[..., ::-1]
    whole = (low < 0) & (high >= cells)
    low, high = np.where(low < 0, high, low), np.where(high >= cells, low, high)
    low, high = (np.where(whole, at, end) for end in (low, high))
    share = ((at - low) / np.maximum(high - low, 1)).astype(sinogram.dtype)
    left, right = (np.take_along_axis(sinogram, end, axis=-1) for end in (low, high))
    return np.where(left_out, (1 - share) * left + share * right, sinogram)


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
    powers = np.vander((np.append(beside, np.arange(first, last)) - 0.5 * (first + last - 1)) / width, degree + 1)
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
