"""The drift chart's statistics of many scanners at a time, for its study: `alternatives` in one loop.

`largest` is compared with the chart's own numbers in tests/benchmarks/test_run_lengths.py.
"""

import numba
import numpy as np

from sawmill_worker.tomography.drift_chart.alternatives import FEWEST_OF_A_TREND
from sawmill_worker.tomography.drift_chart.history import History
from sawmill_worker.tomography.geometry import FloatArray


def largest(history: History, quiet: FloatArray) -> FloatArray:
    """The largest squared length of steps and trends, (2, scanners): by looks' errors alone, and with `quiet` added."""
    segments = (history.baseline, *history.segments)
    lasting = np.cumsum([segment.groups for segment in segments[:0:-1]])[::-1] >= FEWEST_OF_A_TREND
    return _largest(
        np.stack([segment.precision for segment in segments]),
        np.stack([segment.weighted for segment in segments]),
        np.stack([segment.first_days for segment in segments]),
        np.stack([segment.last_days for segment in segments]),
        history.scatter.ratio,
        lasting,
        quiet,
    )


@numba.njit(cache=True)
def _largest(precision, weighted, first_days, last_days, ratio, lasting, quiet):  # noqa: ANN001, ANN202
    size, scanners = first_days.shape
    found = np.zeros((2, scanners))
    for s in range(scanners):
        now = last_days[size - 1, s]
        # a, b, c stand for the upper left, the off-diagonal and the lower right element; d, e for a vector's.
        all_a = all_b = all_c = all_d = all_e = 0.0
        for k in range(size):
            all_a += precision[k, s, 0, 0, 0]
            all_b += precision[k, s, 0, 0, 1]
            all_c += precision[k, s, 0, 1, 1]
            all_d += weighted[k, s, 0, 0]
            all_e += weighted[k, s, 0, 1]
        det = all_a * all_c - all_b * all_b
        every_a, every_b, every_c = all_c / det, -all_b / det, all_a / det
        mean_d, mean_e = every_a * all_d + every_b * all_e, every_b * all_d + every_c * all_e
        plain = np.zeros(5)
        once = np.zeros(5)
        twice = np.zeros(3)
        for k in range(size - 1, 0, -1):
            later = first_days[k, s] - now
            for j, (row, column) in enumerate(((0, 0), (0, 1), (1, 1))):
                p0, p1 = precision[k, s, 0, row, column], precision[k, s, 1, row, column]
                plain[j] += p0
                once[j] += p1 + later * p0
                twice[j] += precision[k, s, 2, row, column] + 2.0 * later * p1 + later * later * p0
            for j in range(2):
                plain[3 + j] += weighted[k, s, 0, j]
                once[3 + j] += weighted[k, s, 1, j] + later * weighted[k, s, 0, j]
            before_a, before_b, before_c = all_a - plain[0], all_b - plain[1], all_c - plain[2]
            before, after = before_a * before_c - before_b * before_b, plain[0] * plain[2] - plain[1] * plain[1]
            before_d, before_e = all_d - plain[3], all_e - plain[4]
            step_d = (plain[2] * plain[3] - plain[1] * plain[4]) / after
            step_e = (plain[0] * plain[4] - plain[1] * plain[3]) / after
            step_d -= (before_c * before_d - before_b * before_e) / before
            step_e -= (before_a * before_e - before_b * before_d) / before
            _count(
                found, s, step_d, step_e, before_c / before + plain[2] / after,
                -before_b / before - plain[1] / after, before_a / before + plain[0] / after, ratio[s], quiet, 1.0,
            )  # fmt: skip
            span = now - last_days[k - 1, s]
            if not lasting[k - 1]:
                continue
            along_a, along_b, along_c = once[0] + span * plain[0], once[1] + span * plain[1], once[2] + span * plain[2]
            left_a, left_b = every_a * along_a + every_b * along_b, every_a * along_b + every_b * along_c
            right_a, right_b = every_b * along_a + every_c * along_b, every_b * along_b + every_c * along_c
            square_a = twice[0] + 2.0 * span * once[0] + span * span * plain[0] - along_a * left_a - along_b * right_a
            square_b = twice[1] + 2.0 * span * once[1] + span * span * plain[1] - along_a * left_b - along_b * right_b
            square_c = twice[2] + 2.0 * span * once[2] + span * span * plain[2] - along_b * left_b - along_c * right_b
            square = square_a * square_c - square_b * square_b
            slope_d = once[3] + span * plain[3] - along_a * mean_d - along_b * mean_e
            slope_e = once[4] + span * plain[4] - along_b * mean_d - along_c * mean_e
            _count(
                found, s, (square_c * slope_d - square_b * slope_e) / square,
                (square_a * slope_e - square_b * slope_d) / square, square_c / square, -square_b / square,
                square_a / square, ratio[s], quiet, span,
            )  # fmt: skip
    return found


@numba.njit(cache=True)
def _count(found, s, d, e, a, b, c, ratio, quiet, span):  # noqa: ANN001, ANN202
    """Keep the larger squared length of (d, e) by the scaled covariance (a, b, c), without and with quiet / span^2."""
    first = np.sqrt(a)
    cross = b / first
    second = np.sqrt(c - cross * cross)
    upper, mixed, lower = ratio[0, 0], ratio[0, 1], ratio[1, 1]
    a, b = a * upper, first * (upper * cross + mixed * second)
    c = upper * cross * cross + 2.0 * mixed * cross * second + lower * second * second
    for k in range(2):
        if k == 1:
            a, c = a + quiet[0, 0] / (span * span), c + quiet[1, 1] / (span * span)
        length = (c * d * d - 2.0 * b * d * e + a * e * e) / (a * c - b * b)
        found[k, s] = max(found[k, s], length)
