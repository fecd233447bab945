"""Shifts of views that lost rows, from the mass of the log's slices.

The sum over a detector row is the mass of that slice of the log, which hardly changes as the log turns: the views'
profiles of sums are equal up to a shift.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.preparing import row_shifts
from sawmill_tomography.sinograms.present_rows import Rows

# A view shares at least this part of its rows with the other views, and needs this number of rows for a profile
# (benchmarks/preparing.py at 3ab7f653, as the constants below).
SHARE_FOUND, FEWEST_ROWS = 0.5, 16
# Least difference in log likelihood between a view's best position and the next best one.
DISTINCT = 15.0
# The iteration ends when no shift moves by more rows than this.
ROUNDS, SETTLED = 12, 0.002
RIDGE = 1e-10
# Neighbouring rows depart from the common profile together (a knot nearer to the source) over about 8 rows.
CORRELATED_ROWS = 8
# A row loses weight beyond this number of median departures.
OUTLYING = 3.0
# The least eigenvalue of the normal equations for a row's first moments: half of six views over a full turn.
FEWEST_TURNING = 3.0


@dataclass(frozen=True, eq=False)
class RowMoments:
    """The mass and first moment of a row's line integrals."""

    mass: FloatArray  # (views, rows): mass; NaN where a row is missing
    first: FloatArray  # (views, rows): sum of line integral times distance from the common centroid, in cells

    @classmethod
    def of(cls, images: Iterable[row_shifts.Stack], cells: NDArray[np.bool_]) -> "RowMoments":
        """Compute the moments of all views' images (rows, cells) over some of the cells: air adds only noise."""
        over = cells.astype(np.float32)
        weights = np.stack([over, over * np.linspace(-0.5, 0.5, over.size, dtype=np.float32)], axis=1)
        mass, first = np.moveaxis(np.stack([image @ weights for image in images]).astype(np.float64), 2, 0)
        centroid = np.nansum(first) / (np.nansum(mass) or 1.0)
        return cls(mass, (first - centroid * mass) * max(over.size - 1, 1))


def shifts_by_mass(moments: RowMoments, angles_rad: FloatArray) -> row_shifts.RowShifts:
    """Estimate each view's shift from the row sums.

    A view's profile of row sums is the common one up to a gain (its distance from the source), an offset and a slope
    (air, the log's bend). A coarse shift by masked normalised cross-correlation (Padfield, IEEE Trans. Image Process.
    21 (2012) 2706) is refined by least squares against the median of all views, in turns.

    A part nearer to the source weighs more, by its depth over the source's distance, once in a turn: uncorrected, a
    whorl's knots at different heights would seem to move along the log. The first moments a quarter turn away show the
    depth, so that only one number for all views has to be fitted.

    Raises
    ------
    RowsError
        If the profile varies too little.
    """
    present = np.isfinite(moments.mass)
    rows = int(present.sum(axis=1).min())
    if rows < FEWEST_ROWS:
        view = int(present.sum(axis=1).argmin())
        raise row_shifts.RowsError(
            f"view {view} has {rows} rows and at least {FEWEST_ROWS} are needed to find its place by them"
        )
    mass, first = (np.where(present, values, 0.0) for values in (moments.mass, moments.first))
    longest = int(present.sum(axis=1).argmax())
    if np.ptp(mass[longest, present[longest]]) == 0.0:
        raise row_shifts.RowsError(
            f"all rows of view {longest} have the same sum: nothing in them shows where it lies along the log"
        )
    reference = _Profile(mass[longest], present[longest], 0)
    for _ in range(2):
        score, lags = _scores(mass, present, reference)
        shifts = lags[score.argmax(axis=1)].astype(np.float64)
        reference = _common(mass, present, _fit(mass, present, shifts, reference), shifts)
    _check_distinct(mass, present, reference)
    fit, values, weight = _fit(mass, present, shifts, reference), mass, 0.0
    for _ in range(ROUNDS):
        step = np.clip(fit.step - np.median(fit.step), -1.0, 1.0)
        shifts = shifts + step
        depth = _depth(first, present, shifts, angles_rad)
        # The share of the depth in the residual, after the fit's own terms are projected out of both.
        free = _fit(depth, present, shifts, reference).residual
        weight += float((fit.residual * free).sum() / max((free**2).sum(), np.finfo(np.float64).tiny))
        values = mass - weight * depth
        reference = _common(values, present, fit, shifts)
        fit = _fit(values, present, shifts, reference)
        if np.abs(step).max() < SETTLED:
            break
    row_shifts.check_certain(fit.standard_deviation, "the log varies too little along its length for the noise")
    return row_shifts.RowShifts.of(
        shifts, fit.standard_deviation, present, np.flatnonzero(reference.jumps) + reference.origin
    )


def _depth(first: FloatArray, present: Rows, shifts: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Return mass times depth towards the source (or away: the sign is left open) in each view's rows (views, rows).

    The depth comes from the part of the first moments that turns with the log: across the rays it is the cosine and
    sine of the angle, along them the derivative.
    """
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    place = np.rint(np.arange(first.shape[1]) + shifts[:, None]).astype(np.intp)
    place -= place.min()
    turning = np.stack([np.ones_like(cosine), cosine, sine], axis=1)
    length = int(place.max()) + 1
    normal, right = np.zeros((length, 3, 3)), np.zeros((length, 3))
    view, row = np.nonzero(present)
    np.add.at(normal, place[view, row], turning[view][:, :, None] * turning[view][:, None, :])
    np.add.at(right, place[view, row], turning[view] * first[view, row, None])
    scarce = np.linalg.eigvalsh(normal)[:, 0] < FEWEST_TURNING
    normal[scarce], right[scarce] = np.eye(3), 0.0
    _, along_cosine, along_sine = np.linalg.solve(normal, right[..., None])[..., 0].T
    return np.where(present, along_sine[place] * cosine[:, None] - along_cosine[place] * sine[:, None], 0.0)


@dataclass(frozen=True, eq=False)
class _Profile:
    """The common profile along the log, whose first value belongs to row `origin`."""

    mass: FloatArray
    present: Rows
    origin: int

    @cached_property
    def jumps(self) -> Rows:
        """Rows (rows,) from which the profile jumps to the next one."""
        return row_shifts.jumps_between(np.where(self.present, self.mass, np.nan))


@dataclass(frozen=True, eq=False)
class _ProfileFit:
    """Fit of each view to the reference: its step, gain, offset and slope, and the residual."""

    step: FloatArray
    standard_deviation: FloatArray
    gain: FloatArray
    trend: FloatArray
    residual: FloatArray


def _check_distinct(values: FloatArray, present: Rows, reference: _Profile) -> None:
    score, _ = _scores(values, present, reference)
    best = score.argmax(axis=1)
    other_scores = np.where((score[:, 1:-1] >= score[:, :-2]) & (score[:, 1:-1] >= score[:, 2:]), score[:, 1:-1], 0.0)
    np.put_along_axis(other_scores, np.clip(best - 1, 0, other_scores.shape[1] - 1)[:, None], 0.0, axis=1)
    lead = score.max(axis=1) - other_scores.max(axis=1)
    if lead.min() < DISTINCT:
        raise row_shifts.RowsError(
            f"the place of view {int(lead.argmin())} along the log is not clear: its row sums fit elsewhere about as "
            "well. The log varies too little along its length for its views to be aligned"
        )


def _scores(values: FloatArray, present: Rows, reference: _Profile) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the log-likelihood (views, lags) of shifts, -n / 2 ln(1 - r^2) of profile slopes, and the shifts (lags,).

    Slopes do not depend on an offset nor, less their mean, on a taper.
    """
    moving, there = _slopes(values, present)
    fixed, fixed_there = _slopes(reference.mass[None], reference.present[None])
    length = scipy.fft.next_fast_len(moving.shape[1] + fixed.shape[1], real=True)

    def spectrum(a: FloatArray | Rows) -> NDArray[np.complex128]:
        return np.asarray(scipy.fft.rfft(a.astype(np.float64), length, axis=1))

    def overlap(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> FloatArray:
        return np.asarray(scipy.fft.irfft(a * b.conj(), length, axis=1))

    f, f2, f_there = spectrum(fixed), spectrum(fixed**2), spectrum(fixed_there)
    m, m2, m_there = spectrum(moving), spectrum(moving**2), spectrum(there)
    count = np.maximum(overlap(f_there, m_there), 1.0)
    f_sum, m_sum = overlap(f, m_there), overlap(f_there, m)
    variances = (overlap(f2, m_there) - f_sum**2 / count) * (overlap(f_there, m2) - m_sum**2 / count)
    floor = 1e-12 * float((fixed**2).sum()) * (moving**2).sum(axis=1, keepdims=True) + np.finfo(np.float64).tiny
    correlation = (overlap(f, m) - f_sum * m_sum / count) / np.sqrt(np.maximum(variances, floor))
    enough = count >= np.maximum(SHARE_FOUND * there.sum(axis=1, keepdims=True), FEWEST_ROWS // 2)
    likely = -0.5 * count * np.log1p(-(np.clip(correlation, 0.0, 1.0 - 1e-9) ** 2))
    lags = np.fft.fftfreq(length, 1.0 / length).astype(np.intp)
    order = np.argsort(lags)
    return np.where(enough, likely, 0.0)[:, order], lags[order] + reference.origin


def _slopes(values: FloatArray, present: Rows) -> tuple[FloatArray, Rows]:
    """Return central differences (views, rows - 2), zero where a row is missing, and where they exist."""
    there = present[:, 2:] & present[:, :-2]
    return np.where(there, values[:, 2:] - values[:, :-2], 0.0), there


def _fit(values: FloatArray, present: Rows, shifts: FloatArray, reference: _Profile) -> _ProfileFit:
    """Fit each view by the reference, its derivative, a constant and a slope (least squares); outliers lose weight."""
    views, rows = values.shape
    at = np.arange(rows) + shifts[:, None] - reference.origin
    below = np.floor(at).astype(np.intp)
    taps = np.clip(below[..., None] + np.arange(-1, 3), 0, reference.mass.size - 1)
    inside = present & (below >= 1) & (below + 2 < reference.mass.size) & reference.present[taps].all(axis=2)
    around = reference.mass[taps]
    weights, slopes = row_shifts.row_weights(at - below, reference.jumps[np.clip(below, 0, reference.mass.size - 1)])
    level = float(reference.mass[reference.present].mean())
    terms = np.stack(
        [
            (weights * around).sum(axis=2) - level,
            (slopes * around).sum(axis=2),
            np.ones((views, rows)),
            np.broadcast_to(_along(rows), (views, rows)),
        ],
        axis=2,
    )
    terms *= inside[..., None]
    scale = np.sqrt((terms**2).sum(axis=1)) + np.finfo(np.float64).tiny
    terms /= scale[:, None, :]
    robust = inside.astype(np.float64)
    for _ in range(4):
        weighted = (terms * robust[..., None]).transpose(0, 2, 1)
        normal = weighted @ terms + RIDGE * np.eye(4)
        solved = np.linalg.solve(normal, weighted @ values[..., None])
        residual = np.where(inside, values - (terms @ solved)[..., 0], 0.0)
        spread = np.nanmedian(np.where(inside, np.abs(residual), np.nan), axis=1, keepdims=True)
        outlying = np.maximum(np.abs(residual), OUTLYING * spread) + np.finfo(np.float64).tiny
        robust = np.where(inside, (OUTLYING * spread + np.finfo(np.float64).tiny) / outlying, 0.0)
    coefficients = solved[..., 0] / scale
    gain = coefficients[:, 0]
    influence = (terms @ np.linalg.inv(normal)[:, :, 1:2])[..., 0] * robust * residual
    variance = _long_run_variance(influence) / scale[:, 1] ** 2
    trend = np.stack([coefficients[:, 2] - gain * level, coefficients[:, 3]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        step, deviation = coefficients[:, 1] / gain, np.sqrt(variance) / np.abs(gain)
    bad = ~(gain > 0.0)
    return _ProfileFit(
        np.where(bad, 0.0, step), np.where(bad, np.inf, deviation), np.where(bad, 1.0, gain), trend, residual
    )


def _long_run_variance(influence: FloatArray) -> FloatArray:
    """Return the variance of each view's summed influences (views, rows), correlated in rows (Newey and West 1987)."""
    variance: FloatArray = (influence**2).sum(axis=1)
    for lag in range(1, CORRELATED_ROWS):
        variance += 2.0 * (1.0 - lag / CORRELATED_ROWS) * (influence[:, lag:] * influence[:, :-lag]).sum(axis=1)
    return np.maximum(variance, 0.0)


def _common(values: FloatArray, present: Rows, fit: _ProfileFit, shifts: FloatArray) -> _Profile:
    """Return the median profile of all views, each brought to the common level; present where half the views are."""
    rows = values.shape[1]
    levelled = (values - (fit.trend[:, :1] + fit.trend[:, 1:] * _along(rows))) / fit.gain[:, None]
    origin = int(np.floor(shifts.min()))
    at = np.arange(rows + int(np.ceil(shifts.max())) - origin) + origin - shifts[:, None]
    below = np.floor(at).astype(np.intp)
    taps = below[..., None] + np.arange(-1, 3)
    view = np.arange(len(values))[:, None, None]
    clipped = np.clip(taps, 0, rows - 1)
    inside = present[view, clipped] & (taps >= 0) & (taps < rows)
    there = np.where(np.isclose(at, below), inside[..., 1], inside.all(axis=2))
    weights, _ = row_shifts.cubic_weights(at - below)
    sampled = (weights * np.where(inside, levelled[view, clipped], 0.0)).sum(axis=2)
    # Unlike the mean, the median of views that mostly share a position keeps the end of a body sharp.
    profile = np.ma.filled(np.ma.median(np.ma.masked_array(sampled, ~there), axis=0), 0.0)
    return _Profile(profile, there.sum(axis=0) >= max(1, len(values) // 2), origin)


def _along(rows: int) -> FloatArray:
    return np.linspace(-1.0, 1.0, rows)
