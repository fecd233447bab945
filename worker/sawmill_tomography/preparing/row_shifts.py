"""Alignment of views of one log that lost rows at the top or the bottom, each view a different number.

Rows are successive positions of a flat detector along the log, so a view is off by one shift in rows, the same for the
whole view. `shifts_by_mass` and `shifts_by_features` find the shifts.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.present_rows import Rows

Stack = NDArray[np.float32]

# Shifts are whole rows when they scatter about whole numbers by less. Uniform fractions scatter by 1 / sqrt(12) = 0.29
# (tests/tomography/preparing/test_row_shifts.py).
WHOLE_SCATTER, WHOLE_FURTHEST = 0.12, 0.4
# Rows: a shift less certain than this blurs more than it corrects (benchmarks/preparing.py at 3ab7f653).
MOST_UNCERTAIN = 0.3
# A view's shift counts as a whole number within this number of its standard deviations; or, where at least half of the
# views are whole rows apart, within this number of rows: shifts are found to 0.07 rows, and resampling a view that
# is where it should be costs more than it corrects (benchmarks/lost_rows.py at 3ab7f653).
SAME_DEVIATIONS, SAME_PLACE, MOST_VIEWS = 2.0, 0.15, 0.5
# Departures of neighbouring rows are correlated, so shifts scatter more than estimated: by this factor if no views
# share a position, which would show it. Interpolation between rows adds an error too
# (benchmarks/lost_rows.py at 3ab7f653).
UNSEEN_INFLATION, BETWEEN_ROWS = 2.0, 0.03
# A step of the row sums is the end of a body where it is this many times the two before, the two after and the median
# (benchmarks/lost_rows.py at 3ab7f653).
JUMP = 4.0


class RowsError(ValueError):
    """Views that cannot be aligned; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class RowShifts:
    """Position of each view along the log."""

    # (views,): row i of view k shows row i + rows[k] of the scan: 0 for most of the views that have all rows
    rows: FloatArray
    # (views,): standard deviation of each shift, in rows, before rounding; enlarged to the scatter of views that share
    # a position
    standard_deviation: FloatArray
    whole: bool  # True if the shifts were found to be whole numbers and were rounded
    # (n,) integers: last rows of bodies along the log, such as a phantom before it: the next row shows another body
    ends: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))

    @classmethod
    def of(
        cls, shifts: FloatArray, standard_deviation: FloatArray, present: Rows, ends: NDArray[np.intp] | None = None
    ) -> "RowShifts":
        """Return shifts from estimates and bodies' ends of any origin, for views with rows `present` (views, rows).

        All shifts are rounded if the views are whole rows apart; otherwise only shifts that are nearly whole are.
        """
        ends = np.zeros(0, np.intp) if ends is None else ends
        apart = shifts - float(np.angle(np.exp(2j * np.pi * shifts).mean()) / (2.0 * np.pi))
        off = apart - np.rint(apart)
        whole = bool(off.std() < WHOLE_SCATTER and np.abs(off).max() < WHOLE_FURTHEST)
        if whole:
            standard_deviation = standard_deviation * _inflation(off, standard_deviation)
            rows = np.rint(apart)
            rows -= _origin(rows, present)
            rows = _within(rows, present)
            return cls(rows, standard_deviation, whole, _moved(ends, shifts, rows))
        rows = shifts - _origin(shifts, present)
        off = rows - np.rint(rows)
        sharing = np.abs(off) <= SAME_PLACE
        shared = bool(sharing.sum() >= MOST_VIEWS * sharing.size)
        inflation = _inflation(off[sharing], standard_deviation[sharing]) if shared else UNSEEN_INFLATION
        standard_deviation = standard_deviation * inflation
        same = np.maximum(SAME_PLACE if shared else 0.0, SAME_DEVIATIONS * standard_deviation)
        settled = np.abs(off) <= np.minimum(same, WHOLE_FURTHEST)
        rows = _within(np.where(settled, np.rint(rows), rows), present)
        standard_deviation = np.hypot(standard_deviation, np.where(settled, 0.0, BETWEEN_ROWS))
        return cls(rows, standard_deviation, bool(settled.all()), _moved(ends, shifts, rows))

    def lost(self, present: Rows) -> bool:
        """Return whether each view, with the rows `present` (views, rows), is moved to rows that the detector has.

        Then rows were lost after the detector, and a view's samples belong to the detector's rows to which it is moved;
        otherwise the log itself moved.
        """
        first, last = _ends(present)
        return self.whole and bool((first + self.rows).min() >= 0 and (last + self.rows).max() < present.shape[1])


def _moved(ends: NDArray[np.intp], shifts: FloatArray, rows: FloatArray) -> NDArray[np.intp]:
    """Convert ends of bodies from the count of `shifts` to the count of `rows`."""
    return np.rint(ends + np.median(rows - shifts)).astype(np.intp)


def _origin(shifts: FloatArray, present: Rows) -> float:
    """Return the shift that most of the views with most rows share."""
    count = present.sum(axis=1)
    longest = shifts[count == count.max()]
    near = np.abs(longest[:, None] - longest) <= SAME_PLACE
    return float(np.median(longest[near[near.sum(axis=1).argmax()]]))


def _inflation(errors: FloatArray, standard_deviation: FloatArray) -> float:
    """Return the root mean square ratio of errors of known shifts to their estimated errors; at least 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = errors / standard_deviation
    return max(1.0, float(np.sqrt(np.mean(ratios[np.isfinite(ratios)] ** 2)))) if np.isfinite(ratios).any() else 1.0


def _within(rows: FloatArray, present: Rows) -> FloatArray:
    """Move all shifts by whole rows if this brings all views inside the detector."""
    first, last = _ends(present)
    above, below = (math.ceil(over) for over in (-(first + rows).min(), (last + rows).max() - present.shape[1] + 1))
    return rows if above + below > 0 else rows + float(max(above, 0) - max(below, 0))


def _ends(present: Rows) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the last present row of each view, for present rows (..., rows)."""
    return present.argmax(axis=-1), present.shape[-1] - 1 - present[..., ::-1].argmax(axis=-1)


def check_certain(standard_deviation: FloatArray, why: str) -> None:
    """Refuse shifts (views,) whose standard deviation, in rows, is too large, with the likely reason: RowsError."""
    if not standard_deviation.max() <= MOST_UNCERTAIN:
        view = int(standard_deviation.argmax())
        raise RowsError(
            f"the shift of view {view} is uncertain by {standard_deviation[view]:.2g} rows and {MOST_UNCERTAIN} is the "
            f"most allowed: {why}"
        )


def shifted(image: Stack, present: NDArray[np.bool_], shift: float, ends: NDArray[np.intp] | None = None) -> Stack:
    """Move a view's image (rows, cells) with the rows `present` (rows,) along the log: NaN where it has no row.

    A whole shift moves rows; a fraction resamples them by cubic convolution, the first and last rows repeated. A mix of
    the last row of a body and the next row shows neither: each side of the end, by `ends`, is resampled independently.
    """
    out = np.full_like(image, np.nan)
    first, last = (int(end) for end in _ends(present))
    if float(shift).is_integer():
        low, high = max(first + int(shift), 0), min(last + int(shift), len(image) - 1)
        out[low : high + 1] = image[low - int(shift) : high + 1 - int(shift)]
        return out
    at: FloatArray = np.arange(len(image), dtype=np.float64) - shift
    mixed = [int(np.rint(end + 0.5 - shift)) for end in ([] if ends is None else ends.tolist())]
    for before, after in pairwise([first - 1, *(row for row in mixed if first < row < last), last + 1]):
        there = (at >= before + 1) & (at <= after - 1)
        out[there] = _resampled(image[before + 1 : after], at[there] - before - 1)
    return out


def _resampled(image: Stack, at: FloatArray) -> Stack:
    """Resample the rows of an image (rows, cells) at fractional positions."""
    below = np.floor(at).astype(np.intp)
    weights, _ = cubic_weights(at - below)
    taps = np.clip(below[:, None] + np.arange(-1, 3), 0, len(image) - 1)
    out = np.zeros((at.size, image.shape[1]), np.float32)
    for tap in range(4):
        out += weights[:, tap, None].astype(np.float32) * image[taps[:, tap]]
    return out


def jumps_between(profile: FloatArray) -> Rows:
    """Select the row sums (rows,), NaN where missing, that jump from a row to the next: where one body ends."""
    steps = np.pad(np.abs(np.diff(np.nan_to_num(profile, nan=np.nanmedian(profile)))), (2, 3))
    beside = np.max([steps[offset : offset + profile.size] for offset in (0, 1, 3, 4)], axis=0)
    middle = steps[2 : profile.size + 2]
    there = np.isfinite(profile) & np.isfinite(np.append(profile[1:], np.nan))
    return np.asarray(there & (middle > JUMP * np.maximum(beside, np.median(middle))), bool)


def row_weights(fraction: FloatArray, jumps: Rows) -> tuple[FloatArray, FloatArray]:
    """Return the weights of the four rows around a fraction of a row, and their derivatives (`cubic_weights`).

    Where a body ends between the two rows next to the fraction, a detector's row that shows part of both shows them by
    their shares: linear interpolation, from which a cubic differs by up to 0.05 rows.
    """
    weights, slopes = cubic_weights(fraction)
    nothing, one = np.zeros_like(fraction), np.ones_like(fraction)
    linear = np.stack([nothing, 1.0 - fraction, fraction, nothing], axis=-1)
    linear_slopes = np.stack([nothing, -one, one, nothing], axis=-1)
    where = jumps[..., None]
    return np.where(where, linear, weights), np.where(where, linear_slopes, slopes)


def cubic_weights(fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute cubic convolution at a fraction of a row: weights (..., 4) from one row below on, and derivatives.

    Keys, IEEE Trans. Acoustics, Speech, and Signal Processing 29 (1981) 1153, equation 15.
    """
    f = fraction
    weights = [f * (-0.5 + f * (1.0 - 0.5 * f)), 1.0 + f**2 * (1.5 * f - 2.5), f * (0.5 + f * (2.0 - 1.5 * f))]
    slopes = [-0.5 + f * (2.0 - 1.5 * f), f * (4.5 * f - 5.0), 0.5 + f * (4.0 - 4.5 * f)]
    last, last_slope = 0.5 * f**2 * (f - 1.0), f * (1.5 * f - 1.0)
    return np.stack([*weights, last], axis=-1), np.stack([*slopes, last_slope], axis=-1)
