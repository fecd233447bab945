"""Shifts of views that lost rows, from features seen in neighbouring views.

Knots and bark move across the detector as the log turns, and stay in their row. Features are detected, described (SIFT:
Lowe, Int. J. Computer Vision 60 (2004) 91) and matched between views that are neighbours in angle; of the matches'
shifts along the log the one with most inliers is taken, as RANSAC does, with every match as a hypothesis.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from skimage.feature import SIFT, match_descriptors

from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.preparing.row_shifts import RowsError, RowShifts, Stack, check_certain, jumps_between
from sawmill_tomography.sinograms.present_rows import Rows, present_rows

# SIFT fails with an IndexError on fewer cells.
FEWEST_ROWS, FEWEST_CELLS = 32, 12
# Number of features kept of a view, the largest; in noise most are small.
MOST_FEATURES = 800
# Contrast of the weakest feature that is kept, of 1, and the width in cells of a Gaussian against noise.
CONTRAST = 0.01 / 3.0
SMOOTHING = 1.0
# Width in cells of the smallest features. Smaller ones are noise: with a width of 1.0, views of a noise of 0.1 are
# aligned wrongly and not refused (benchmarks/preparing.py at 3ab7f653).
SMALLEST = 1.2
# A match is kept if the next best one is farther by this factor (Lowe 2004, section 7.1), and not farther across.
RATIO, FURTHEST_ACROSS = 0.8, 0.25
# Matches agree on a shift within this number of rows; fewer matches, or a smaller share, agree by chance
# (benchmarks/preparing.py at 3ab7f653, as the constants below).
AGREEING_ROWS, FEWEST_AGREEING, SHARE_AGREEING = 0.5, 6, 0.15
# The number of following views that each view is matched with, and the angle over which features stay recognisable.
NEIGHBOURS, FURTHEST_RAD = 2, math.radians(20.0)
# Pairs whose shifts scatter less about whole numbers lost whole rows; rounding prevents errors from adding up.
WHOLE_SCATTER = 0.22
# Rows by which a match may differ from the end of a body, which is known to half a row
# (benchmarks/lost_rows.py at 3ab7f653).
MOST_APART = 0.5
WHAT_FOR = (
    "features are for logs with knots or bark, from views at most "
    f"{math.degrees(FURTHEST_RAD) / 2.0:.0f} degrees apart, 2 where they are noisy"
)
# A pair that differs by more rows than this from the fit to all pairs loses weight.
CONTRADICTING, ROUNDS = 0.25, 10


@dataclass(frozen=True, eq=False)
class _Features:
    """Features of one view: positions (n, 2) as row and cell, descriptors (n, 128), and the last rows of bodies."""

    cells: int
    present: Rows
    ends: NDArray[np.intp]
    at: NDArray[np.float32]
    descriptors: NDArray[np.uint8]


@dataclass(frozen=True)
class _Pair:
    """Two views, and the shift in rows of the second along the log."""

    first: int
    second: int
    shift: float
    standard_deviation: float


def shifts_by_features(images: Iterable[Stack], angles_rad: FloatArray) -> RowShifts:
    """Estimate each view's shift from features matched between neighbouring views.

    Parameters
    ----------
    images : all views' images (rows, cells) float32, one after the other
        Line integrals; missing rows are NaN.
    angles_rad : (views,) float64

    Raises
    ------
    RowsError
        If a view shares too few features with its neighbours.
    """
    features = [_features(view, image) for view, image in enumerate(images)]
    pairs = [_matched(features, one, other) for one, other in _neighbours(angles_rad)]
    return _solved([pair for pair in pairs if pair is not None], np.stack([one.present for one in features]))


def _features(view: int, image: Stack) -> _Features:
    there, cells = present_rows(image), image.shape[1]
    rows = np.flatnonzero(there)
    if rows.size < FEWEST_ROWS:
        raise RowsError(f"view {view} has {rows.size} rows; features need at least {FEWEST_ROWS}")
    if cells < FEWEST_CELLS:
        raise RowsError(f"view {view} has {cells} detector cells; features need at least {FEWEST_CELLS}")
    shown = image[rows]
    # A body ends where a row jumps to the next one, apart from their gain.
    steps = np.diff(shown, axis=0).std(axis=1, dtype=np.float64)
    ends = np.flatnonzero(jumps_between(np.append(0.0, np.cumsum(steps))))
    # A new one for each view, as it adapts to the size of its first image.
    sift: Any = SIFT(upsampling=1, sigma_min=SMALLEST, sigma_in=SMOOTHING, c_dog=CONTRAST)
    try:
        sift.detect_and_extract(_grey(shown, ends))
    except RuntimeError:  # raised for an image without features
        return _Features(cells, there, ends + rows[0], np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
    largest = np.argsort(-sift.sigmas, kind="stable")[:MOST_FEATURES]
    at = sift.positions[largest] + np.array([rows[0], 0.0], np.float32)
    return _Features(cells, there, ends + rows[0], at, sift.descriptors[largest])


def _grey(image: Stack, ends: NDArray[np.intp]) -> Stack:
    """Return the variation along the log (rows, cells), in greys from 0 to 1 that the longest body determines."""
    runs = [slice(first, last) for first, last in pairwise([0, *(ends + 1).tolist(), len(image)])]
    body = max(runs, key=lambda run: run.stop - run.start)
    varying = scipy.ndimage.gaussian_filter(image - np.median(image[body], axis=0), SMOOTHING)
    low, high = np.quantile(varying[body], [0.001, 0.999])
    return np.asarray(np.clip((varying - low) / max(high - low, 1e-30), 0.0, 1.0), np.float32)


def _neighbours(angles_rad: FloatArray) -> list[tuple[int, int]]:
    """Pair views close in angle, across the end of a full turn too."""
    order = np.argsort(angles_rad % TAU)
    pairs = []
    for ahead in range(1, min(NEIGHBOURS, order.size // 2) + 1):
        following = np.roll(order, -ahead)
        near = (angles_rad[following] - angles_rad[order]) % TAU <= FURTHEST_RAD
        pairs += [(int(one), int(other)) for one, other in zip(order[near], following[near], strict=True)]
    return pairs


def _matched(features: list[_Features], first: int, second: int) -> _Pair | None:
    """Return the shift of most matches, or of a body's end in both views that contradicts; None without either."""
    one, other = features[first], features[second]
    matched, ended = _by_matches(one, other), _by_ends(one, other)
    agrees = matched is None or ended is None or abs(matched[0] - ended[0]) <= MOST_APART
    estimate = (matched or ended) if agrees else ended
    return None if estimate is None else _Pair(first, second, *estimate)


def _by_ends(one: _Features, other: _Features) -> tuple[float, float] | None:
    """Return shift and standard deviation from the end of a body, which is known to a row."""
    if one.ends.size != 1 or other.ends.size != 1:
        return None
    return float(one.ends[0] - other.ends[0]), 1.0 / math.sqrt(12.0)


def _by_matches(one: _Features, other: _Features) -> tuple[float, float] | None:
    if min(len(one.at), len(other.at)) < FEWEST_AGREEING:
        return None
    # The article's rule: the nearest in the other view, whether or not the reverse holds too.
    best = match_descriptors(one.descriptors, other.descriptors, cross_check=False, max_ratio=RATIO)
    along, across = (one.at[best[:, 0]] - other.at[best[:, 1]]).T
    along = along[np.abs(across) <= FURTHEST_ACROSS * one.cells]
    if not along.size:
        return None
    agreeing = np.abs(along[:, None] - along) <= AGREEING_ROWS
    inliers = along[agreeing[agreeing.sum(axis=1).argmax()]]
    if inliers.size < max(FEWEST_AGREEING, SHARE_AGREEING * along.size):
        return None
    # The window of agreement limits the precision: a handful of equal shifts proves no more.
    return float(inliers.mean()), max(float(inliers.std()), AGREEING_ROWS / 4.0) / math.sqrt(inliers.size)


def _solved(pairs: list[_Pair], present: Rows) -> RowShifts:
    """Solve least squares over all pairs; the common origin is free."""
    views = len(present)
    if not pairs:
        raise RowsError(
            f"no two views share enough features to be aligned: {WHAT_FOR}; align the rows by their profile"
        )
    ends = np.array([(pair.first, pair.second) for pair in pairs])
    _check_connected(ends, views)
    incidence = np.zeros((len(pairs), views))
    incidence[np.arange(len(pairs)), ends[:, 0]] = -1.0
    incidence[np.arange(len(pairs)), ends[:, 1]] = 1.0
    measured = np.array([pair.shift for pair in pairs])
    shift = np.rint(measured) if (measured - np.rint(measured)).std() < WHOLE_SCATTER else measured
    precision = np.array([pair.standard_deviation for pair in pairs]) ** -2.0
    weight = precision
    for _ in range(ROUNDS):
        # The mean shift is free; the ones make it zero.
        normal = incidence.T @ (weight[:, None] * incidence) + 1.0
        solved = np.linalg.solve(normal, incidence.T @ (weight * shift))
        weight = precision * np.minimum(1.0, CONTRADICTING / np.maximum(np.abs(shift - incidence @ solved), 1e-9))
    inflation = max(1.0, float((weight * (shift - incidence @ solved) ** 2).sum()) / max(len(pairs) - views + 1, 1))
    deviation = np.sqrt(inflation * np.diag(np.linalg.inv(normal)))
    check_certain(deviation, "the views are too far apart or too noisy for features: align the rows by their profile")
    return RowShifts.of(solved, deviation, present)


def _check_connected(ends: NDArray[np.int_], views: int) -> None:
    group = np.arange(views)
    for first, second in ends:
        group[group == group[second]] = group[first]
    names, sizes = np.unique(group, return_counts=True)
    if names.size > 1:
        alone = int(np.flatnonzero(group == names[sizes.argmin()])[0])
        raise RowsError(
            f"view {alone} shares too few features with its neighbours to be aligned with them: {WHAT_FOR}; align the "
            "rows by their profile"
        )
