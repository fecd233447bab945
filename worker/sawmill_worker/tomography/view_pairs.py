"""Pairs of views: what any two fan-beam views of one body have in common, however few views there are.

Let L be the line through the sources of two views, and let it miss the body. A view's rays p(gamma), summed as
p dgamma / cos(angle to L's normal), are the integral of f(x) / dist(x, L) over the plane, since dA = r dr dgamma and
dist(x, L) = r cos(that angle): the same for both. With gamma as in docs/conventions.md#source-frame and 2 delta the
angle from the first view to the second,

    int p_1 dgamma / cos(gamma + delta) = int p_2 dgamma / cos(gamma - delta).

These are the pair conditions of fan-beam data with which Clackdoyle, Desbat, Lesaint and others calibrate. They are
linear in the rays, so the rows of a log may be averaged first, and R is not in them (docs/geometry.md#sparse-scans).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from sawmill_worker.tomography.air import find_air
from sawmill_worker.tomography.calibration.faults.screening import screen
from sawmill_worker.tomography.drift import DetectorFit, DriftError, seen_vector
from sawmill_worker.tomography.geometry import TAU, FloatArray, Scanner, SourceFrame
from sawmill_worker.tomography.paired_rays import fan_angles
from sawmill_worker.tomography.robust import noise_of_differences
from sawmill_worker.vocabulary import FEWEST_PAIRED_VIEWS, Rotation

# Between L's normal and the farthest ray through the log, rad short of a right angle: there a weight is 1 / 0.06.
EDGE_RAD = 0.06
# More pairs cost time. Of too many, those far apart are kept: u_c moves their sums most, by tan(delta).
MOST_PAIRS = 400
FARTHEST = 0.5
# What a view's rays may be too large or too small by, as a share, after the air has been evened out.
GAIN = 0.005
# Combinations of sums that noise leaves better known than this share of a sum say nothing new: pairs repeat each other,
# and what is left there is rounding.
MODEL = 3e-7
# Of a ray in air, as a share of the largest, where a scan shows less: of noise-free data.
LEAST_NOISE = 1e-4
# How far u_c (share of the detector) and tau (rad) may have moved and are still followed: less than EDGE_RAD allows.
REACH = (0.03, 0.2)
# The sense of rotation is known where the other leaves this many times the residual.
DECISIVE = 2.0
STEPS = 8
SMALL_STEP = 1e-2
# Of u_c (mm), tau (rad) and SDD (mm), for derivatives of sums that are smooth in them.
DIFFERENCES = (0.05, 1e-4, 1.0)
# Decimals of delta (rad) beyond which separations of views are the same.
SAME = 9
# Below this share of the largest a direction in the space of gains is rounding.
RANK = 1e-6
# Views that noise and gains do not reconcile, by this variance ratio, are no body at rest where that is what makes u_c
# less certain than this share of a cell.
UNREST, UNREST_CELLS = 25.0, 0.03
# As few comparisons that no gain explains tell the noise to a third.
FEWEST_FREE = 4


class _Lines(NamedTuple):
    """Line integrals (views, cells), 0 beside the log, their variance, the log's cells and what the air's fit leaves.

    Attributes
    ----------
    air_patterns : (3, cells) float64
        A slope, a curvature and a cubic over the detector.
    air_covariance : (views + 3, views + 3) float64
        Of each view's level and of the amplitudes of those patterns, as the air gives them.
    """

    rays: FloatArray
    variance: FloatArray
    cells: NDArray[np.bool_]
    air_patterns: FloatArray
    air_covariance: FloatArray


@dataclass(frozen=True, eq=False)
class _Pairs:
    """First and second view of each pair, and delta, half the angle between them; each (pairs,)."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    delta: FloatArray

    @classmethod
    def of(cls, angles_rad: FloatArray, farthest_rad: float) -> "_Pairs":
        """Those whose line misses a log of this half fan angle, evenly thinned to `MOST_PAIRS`."""
        apart = np.mod(angles_rad - angles_rad[:, None], TAU)
        first, second = np.nonzero((apart > 1e-6) & (apart < math.pi - 2.0 * (farthest_rad + EDGE_RAD)))
        delta = 0.5 * apart[first, second]
        if first.size > MOST_PAIRS:
            far = delta >= np.sort(delta)[-max(MOST_PAIRS, int(FARTHEST * delta.size))]
            first, second, delta = first[far], second[far], delta[far]
            # Each view keeps as many partners, spread over all separations.
            order = np.lexsort((delta, first))
            kept = order[np.linspace(0, order.size - 1, MOST_PAIRS).astype(int)]
            first, second, delta = first[kept], second[kept], delta[kept]
        return cls(first, second, delta)


def view_pair_fit(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame, rotation: Rotation
) -> DetectorFit:
    """Fit u_c and tau to what pairs of views have in common, SDD held.

    Parameters
    ----------
    sinogram : (views, detector) float
        Line integrals of anything that turned as one body, with air on both sides of it in every view.
    angles_rad : (views,) float64
        As the scan gives them, any.
    start : SourceFrame
        The calibrated geometry.
    rotation : Rotation
        The calibrated sense; it is kept where the scan does not tell the two apart.

    Raises
    ------
    DriftError
        If the views are too few, the log reaches an end of the detector, or the pairs do not show u_c.
    """
    sinogram, angles_rad = np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64)
    screening = screen(sinogram)
    usable = int(screening.views.sum())
    if usable < FEWEST_PAIRED_VIEWS:
        raise DriftError(
            "sparse-views",
            f"{usable} usable views are too few to be compared: {FEWEST_PAIRED_VIEWS} are needed, all round or not",
        )
    angles_rad = angles_rad[screening.views]
    lines = _lines(screening.bridged(sinogram)[screening.views])
    vector = seen_vector(start)
    fits = {sense: _Comparison.of(scanner, lines, sense.apply(angles_rad), vector).fit(vector) for sense in Rotation}
    other = next(sense for sense in Rotation if sense is not rotation)
    ratio = math.sqrt(fits[other].chi_squared / fits[rotation].chi_squared)
    if ratio < 1.0 / DECISIVE:
        rotation, ratio = other, 1.0 / ratio
    fit = fits[rotation]
    _check_found(scanner, fit, start)
    return DetectorFit(
        float(fit.vector[0]),
        float(fit.vector[1]),
        start.source_to_detector_mm,
        np.pad(fit.covariance, (0, 1)),
        distance_held=True,
        rotation=rotation,
        rotation_ratio=ratio,
        relative_residual=fit.relative_residual,
        distance_sensitivity=fit.distance_sensitivity,
        rotation_decided=ratio > DECISIVE,
        adjustments=screening.adjustments,
    )


def _lines(sinogram: FloatArray) -> _Lines:
    """The log's rays less each view's level and the patterns of all views, as the air on both sides has them."""
    air = find_air(sinogram.astype(np.float32))
    if air is None or not (air.cells[0] and air.cells[-1]):
        raise DriftError(
            "log-cut-off",
            "the log reaches an end of the detector: pairs of views need air on both sides of it in every view",
        )
    if air.cells.all():
        raise DriftError("nothing-seen", "there is air in every cell and no log: scan a log while it turns")
    views, cells = sinogram.shape
    across = np.linspace(-1.0, 1.0, cells)
    patterns = np.stack([across, across**2, across**3])
    own = air.cells
    count, means = int(own.sum()), patterns[:, own].mean(axis=1)
    # Least squares with a level of each view: the patterns come from what is left without the levels.
    centred = patterns[:, own] - means[:, None]
    of_patterns = np.linalg.inv(centred @ centred.T) / views
    amplitudes = of_patterns @ (centred @ sinogram[:, own].sum(axis=0))
    levels = sinogram[:, own].mean(axis=1) - amplitudes @ means
    # The levels share the error of the patterns.
    crossed = np.tile(-(of_patterns @ means)[:, None], views)
    of_levels = np.eye(views) / count + means @ of_patterns @ means
    noise = max(air.noise, LEAST_NOISE * float(sinogram.max()))
    covariance = noise**2 * np.block([[of_levels, crossed.T], [crossed, of_patterns]])
    rays = np.where(own, 0.0, sinogram - levels[:, None] - amplitudes @ patterns)
    return _Lines(rays, _variance(rays, ~own, noise), ~own, patterns, covariance)


def _variance(rays: FloatArray, cells: NDArray[np.bool_], air_noise: float) -> FloatArray:
    """Of each ray: the air's times exp(k p), k from 0 (the same noise everywhere) to 1 (photons) as differences say.

    Structure of the log passes for noise in them, so k is a bound; what is fitted with it is as wide as its residuals.
    """
    inside = rays[:, cells]
    seen = noise_of_differences(np.diff(inside, 2, axis=1), 2)
    mean = max(float(np.median(inside)), 1e-6)
    k = min(max(2.0 * math.log(max(seen, 1e-30) / air_noise) / mean, 0.0), 1.0)
    variance: FloatArray = air_noise**2 * np.exp(k * np.clip(rays, 0.0, None))
    return variance


class _Fit(NamedTuple):
    """u_c and tau in one sense of rotation, (2,), with SDD held.

    Attributes
    ----------
    covariance : (2, 2) float64
    distance_sensitivity : (2,) float64
        Their change per mm of SDD.
    unrest : float
        Variance of what no gain explains, against that of the rays' noise.
    settled : bool
        Whether they came to rest inside the reach.
    """

    vector: FloatArray
    covariance: FloatArray
    distance_sensitivity: FloatArray
    chi_squared: float
    unrest: float
    relative_residual: float
    settled: bool


@dataclass(frozen=True, eq=False)
class _Comparison:
    """The sums of a scan's pairs of views as functions of (u_c, tau, SDD)."""

    scanner: Scanner
    lines: _Lines
    pairs: _Pairs

    @classmethod
    def of(cls, scanner: Scanner, lines: _Lines, angles_rad: FloatArray, start: FloatArray) -> "_Comparison":
        fan, _ = fan_angles(scanner, start)
        pairs = _Pairs.of(angles_rad, float(np.abs(fan[lines.cells]).max()))
        if pairs.first.size < FEWEST_PAIRED_VIEWS:
            raise DriftError(
                "sparse-views",
                f"of the views only {pairs.first.size} pairs stand far enough apart and not opposite each other: "
                "spread them over the turn",
            )
        return cls(scanner, lines, pairs)

    def fit(self, start: FloatArray) -> _Fit:
        """By generalised least squares of the pairs' differences, with Gauss-Newton from the start."""
        width = self.scanner.num_detector_pixels * self.scanner.detector_pitch_mm
        low, high = (start[:2] + side * np.array(REACH) * [width, 1.0] for side in (-1.0, 1.0))
        white, gains = self._whitening(start)
        vector, settled = start, False
        for _ in range(STEPS):
            differences = self._differences(vector)
            slopes = white @ self._slopes(vector, differences, 2)
            covariance = np.linalg.inv(slopes.T @ slopes)
            moved = np.clip(vector[:2] - covariance @ slopes.T @ (white @ differences), low, high)
            small = np.abs(moved - vector[:2]) <= SMALL_STEP * np.sqrt(np.diag(covariance))
            vector = np.append(moved, start[2])
            if small.all():
                settled = bool(((low < moved) & (moved < high)).all())
                break
        left, right = self._sums(vector)
        slopes = white @ self._slopes(vector, left - right, 3)
        scaled, chi_squared, unrest = _scaled(white @ (left - right), slopes[:, :2], white @ gains)
        sensitivity: FloatArray = -np.linalg.pinv(slopes[:, :2]) @ slopes[:, 2]
        residual = float(np.sqrt(np.mean((left - right) ** 2) / np.mean(left**2)))
        return _Fit(vector[:2], scaled, sensitivity, chi_squared, unrest, residual, settled)

    def _weights(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the rays of the log's cells in the first and in the second view of each pair, (pairs, cells) each."""
        fan, covered = (each[self.lines.cells] for each in fan_angles(self.scanner, vector))
        # Views at even steps have few separations.
        delta, of_pair = np.unique(self.pairs.delta.round(SAME), return_inverse=True)
        # 1 / cos(gamma + delta) = 1 / (cos gamma cos delta (1 - tan gamma tan delta))
        shared = np.outer(1.0 / np.cos(delta), covered / np.cos(fan))
        product = np.outer(np.tan(delta), np.tan(fan))
        return (shared / (1.0 - product))[of_pair], (shared / (1.0 + product))[of_pair]

    def _sums(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What each pair's first and second view sum up to, (pairs,) each."""
        rays, (first, second) = self.lines.rays[:, self.lines.cells], self._weights(vector)
        left: FloatArray = np.einsum("pc,pc->p", first, rays[self.pairs.first])
        right: FloatArray = np.einsum("pc,pc->p", second, rays[self.pairs.second])
        return left, right

    def _differences(self, vector: FloatArray) -> FloatArray:
        left, right = self._sums(vector)
        return left - right

    def _slopes(self, vector: FloatArray, differences: FloatArray, unknowns: int) -> FloatArray:
        """Derivatives of the differences, which stand at the vector, by the first of u_c, tau and SDD."""
        steps = np.diag(DIFFERENCES)[:unknowns]
        slopes = [(self._differences(vector + step) - differences) / step.sum() for step in steps]
        return np.stack(slopes, axis=1)

    def _whitening(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What makes the differences independent and of variance 1, (at most pairs, pairs), and gains (pairs, views).

        The gains are what a gain of `GAIN` of each view adds to the differences.
        """
        lines, pairs = self.lines, self.pairs
        weights = self._weights(vector)
        rays, variance = (each[:, lines.cells] for each in (lines.rays, lines.variance))
        size, views, every = pairs.first.size, len(rays), np.arange(pairs.first.size)
        # What moves the differences with a view's gain, with its level, and with the patterns of all views.
        gains, air = np.zeros((size, views)), np.zeros((size, views + len(lines.air_patterns)))
        for sign, view, own in zip((1.0, -1.0), (pairs.first, pairs.second), weights, strict=True):
            gains[every, view] += sign * np.einsum("pc,pc->p", own, rays[view])
            air[every, view] += sign * own.sum(axis=1)
            air[:, views:] += sign * own @ lines.air_patterns[:, lines.cells].T
        # A gain of all views changes nothing; what it would add are the differences themselves.
        gains = GAIN * (gains - gains.mean(axis=1, keepdims=True))
        covariance = gains @ gains.T + air @ lines.air_covariance @ air.T
        for at in range(views):
            first, second = np.flatnonzero(pairs.first == at), np.flatnonzero(pairs.second == at)
            touched, own = np.append(first, second), np.concatenate([weights[0][first], -weights[1][second]])
            covariance[np.ix_(touched, touched)] += (own * variance[at]) @ own.T
        model = (MODEL / GAIN * float(np.abs(gains).max())) ** 2
        spread, directions = np.linalg.eigh(covariance)
        new = spread > model
        whitening: FloatArray = (directions[:, new] / np.sqrt(spread[new] + model)).T
        return whitening, gains


def _scaled(left: FloatArray, slopes: FloatArray, gains: FloatArray) -> tuple[FloatArray, float, float]:
    """The covariance (2, 2) as wide as what is left of the whitened differences asks for, chi-squared, and `unrest`.

    Noise and gains have a scale each: what gains of another size than `GAIN` leave says nothing of the noise, which
    shows in what no gain explains. How well each scale is known counts by Student's t.
    """
    covariance = np.linalg.inv(slopes.T @ slopes)
    space, size, _ = np.linalg.svd(np.hstack([slopes / np.linalg.norm(slopes, axis=0), gains]), full_matrices=False)
    explained = space[:, size > RANK * size[0]]
    free, of_gains = len(left) - explained.shape[1], explained.shape[1] - slopes.shape[1]
    if free < FEWEST_FREE:
        raise DriftError(
            "sparse-views",
            f"the views' pairs leave {max(free, 0)} comparisons that no gain of a view explains, and {FEWEST_FREE} are "
            "needed to tell how sure they are: take more views",
        )
    chi_squared = float(left @ left)
    noise = chi_squared - float(np.sum((explained.T @ left) ** 2))
    through = covariance @ slopes.T @ gains
    by_gains = through @ through.T
    widths = [
        chi / number * (stdtrit(number, 0.975) / ndtri(0.975)) ** 2
        for chi, number in ((noise, free), (chi_squared - noise, of_gains))
    ]
    return widths[0] * (covariance - by_gains) + widths[1] * by_gains, chi_squared, noise / free


def _check_found(scanner: Scanner, fit: _Fit, start: SourceFrame) -> None:
    pitch_mm, deviation_mm = scanner.detector_pitch_mm, math.sqrt(fit.covariance[0, 0])
    if not deviation_mm < pitch_mm * max(1.0, math.sqrt(fit.unrest)):
        raise DriftError(
            "nothing-seen",
            f"pairs of views place the centre of rotation to {deviation_mm:.2g} mm on the detector, which is more than "
            f"a cell of {pitch_mm:.3g} mm: average more rows, spread the views over more of the turn, or calibrate "
            "with the phantom",
        )
    if not fit.settled:
        raise DriftError(
            "moved-too-far",
            f"no geometry near the calibrated one (u_c {start.cor_column_mm:.4g} mm) makes the views agree: the log "
            "moved while it was scanned, the calibration is another scanner's, or the geometry moved by more than "
            f"{REACH[0]:.0%} of the detector; calibrate with the phantom",
        )
    if fit.unrest > UNREST and deviation_mm > UNREST_CELLS * pitch_mm:
        raise DriftError(
            "moved-too-far",
            f"the views differ {math.sqrt(fit.unrest):.2g} times more than noise and gains of the views explain: the "
            "log moved while it was scanned, or the angles are not those of the views; secure the log and scan again",
        )
