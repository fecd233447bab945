"""Alignment of views of one log that lost rows at the top or the bottom, each view a different number.

Rows are successive positions of a flat detector along the log, so a view is off by one shift in rows, the same
everywhere in it. `shifts_by_mass` and `shifts_by_features` find the shifts.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography.geometry import FloatArray

Stack = NDArray[np.float32]
Rows = NDArray[np.bool_]

# Shifts are whole rows when they scatter about whole numbers by less. Uniform fractions scatter by 1 / sqrt(12) = 0.29
# (tests/tomography/preparing/test_row_shifts.py).
WHOLE_SCATTER, WHOLE_FURTHEST = 0.12, 0.4
# Rows: a shift less certain than this blurs more than it corrects (benchmarks/preparing.py).
MOST_UNCERTAIN = 0.3


class RowsError(ValueError):
    """Views that cannot be aligned; the message says why."""


@dataclass(frozen=True, eq=False)
class RowShifts:
    """Where each view lies along the log.

    Attributes
    ----------
    rows : (views,) float64
        Row i of view k shows what row i + rows[k] of the log is; the smallest is 0.
    standard_deviation : (views,) float64
        Of each, in rows, before they were taken as whole.
    whole : bool
        Whether they turned out to be whole numbers and were rounded.
    """

    rows: FloatArray
    standard_deviation: FloatArray
    whole: bool

    @classmethod
    def of(cls, shifts: FloatArray, standard_deviation: FloatArray) -> "RowShifts":
        """From shifts with any origin; taken as whole rows where they are whole rows apart."""
        common = float(np.angle(np.exp(2j * np.pi * shifts).mean()) / (2.0 * np.pi))
        apart = shifts - common
        off = apart - np.rint(apart)
        whole = bool(off.std() < WHOLE_SCATTER and np.abs(off).max() < WHOLE_FURTHEST)
        rows = np.rint(apart) if whole else shifts
        return cls(rows - rows.min(), standard_deviation, whole)


def present_rows(stack: Stack) -> Rows:
    """Which rows (..., rows) of images (..., rows, cells) are there: a missing row is NaN in every cell."""
    return ~np.isnan(stack[..., 0])


def check_certain(standard_deviation: FloatArray, why: str) -> None:
    """Refuse shifts (views,) whose standard deviation, in rows, is too large, with the likely reason: RowsError."""
    if not standard_deviation.max() <= MOST_UNCERTAIN:
        view = int(standard_deviation.argmax())
        raise RowsError(
            f"the shift of view {view} is uncertain by {standard_deviation[view]:.2g} rows and {MOST_UNCERTAIN} is the "
            f"most allowed: {why}"
        )


@dataclass(frozen=True, eq=False)
class CommonRows:
    """The rows of the log that all views have, and where each view has them.

    Attributes
    ----------
    shifts : RowShifts
    begin, end : int
        The common rows, counted along the log.
    first, last : (views,) integers
        The first and the last row of each view that is there.
    """

    shifts: RowShifts
    begin: int
    end: int
    first: NDArray[np.intp]
    last: NDArray[np.intp]

    @classmethod
    def of(cls, present: Rows, shifts: RowShifts) -> "CommonRows":
        """From the rows (views, rows) that are there.

        Raises
        ------
        RowsError
            Where the views have no row in common.
        """
        first = present.argmax(axis=1)
        last = present.shape[1] - 1 - present[:, ::-1].argmax(axis=1)
        begin = int(np.ceil((first + shifts.rows).max() - 1e-9))
        end = int(np.floor((last + shifts.rows).min() + 1e-9)) + 1
        if end <= begin:
            raise RowsError("the views have no row of the log in common: leave out the views that lost most rows")
        return cls(shifts, begin, end, first, last)

    def of_view(self, view: int, image: Stack) -> Stack:
        """The common rows of a view's image (rows, cells), moved by its shift.

        Whole shifts move rows; others resample them by cubic convolution.
        """
        shift = self.shifts.rows[view]
        if self.shifts.whole:
            start = self.begin - int(shift)
            return image[start : start + self.end - self.begin]
        there = image[self.first[view] : self.last[view] + 1]
        return _resampled(there, np.arange(self.begin, self.end) - shift - self.first[view])


def _resampled(image: Stack, at: FloatArray) -> Stack:
    """Rows of an image (rows, cells) at fractional positions."""
    below = np.floor(at).astype(np.intp)
    weights, _ = cubic_weights(at - below)
    taps = np.clip(below[:, None] + np.arange(-1, 3), 0, len(image) - 1)
    out = np.zeros((at.size, image.shape[1]), np.float32)
    for tap in range(4):
        out += weights[:, tap, None].astype(np.float32) * image[taps[:, tap]]
    return out


def cubic_weights(fraction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cubic convolution at a fraction of a row: weights (..., 4) of the rows from one below on, and their derivatives.

    Keys, IEEE Trans. Acoustics, Speech, and Signal Processing 29 (1981) 1153, equation 15.
    """
    f = fraction
    weights = [f * (-0.5 + f * (1.0 - 0.5 * f)), 1.0 + f**2 * (1.5 * f - 2.5), f * (0.5 + f * (2.0 - 1.5 * f))]
    slopes = [-0.5 + f * (2.0 - 1.5 * f), f * (4.5 * f - 5.0), 0.5 + f * (4.0 - 4.5 * f)]
    last, last_slope = 0.5 * f**2 * (f - 1.0), f * (1.5 * f - 1.0)
    return np.stack([*weights, last], axis=-1), np.stack([*slopes, last_slope], axis=-1)
