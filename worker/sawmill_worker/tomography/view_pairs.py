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
# More pairs cost time and say nothing new: their sums are smooth in delta.
MOST_PAIRS = 400
# What a view's rays may be too large or too small by, as a share, after the air has been evened out.
GAIN = 0.005
# Combinations of sums that noise leaves better known than this share of a sum say nothing new: pairs repeat each other,
# and what is left there is rounding.
MODEL = 3e-7
# Of a ray in air, as a share of the largest, where a scan shows less: of noise-free data.
LEAST_NOISE = 1e-6
# How far u_c (share of the detector) and tau (rad) may have moved and are still followed: less than EDGE_RAD allows.
REACH = (0.03, 0.2)
# The sense of rotation is known where the other leaves this many times the residual.
DECISIVE = 2.0
STEPS = 8
SMALL_STEP = 1e-2
# Of u_c (mm), tau (rad) and SDD (mm), for derivatives of sums that are smooth in them.
DIFFERENCES = (0.05, 1e-4, 1.0)


class _Lines(NamedTuple):
    """Line integrals (views, cells), 0 beside the log, their variance, the log's cells and what the air's fit leaves.

    Attributes
    ----------
    air_patterns : (2, cells) float64
        A slope and a curvature over the detector.
    air_covariance : (views + 2, views + 2) float64
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
    """The log's rays less each view's level and a slope and a curvature of all, as the air on both sides has them."""
    air = find_air(sinogram.astype(np.float32))
    if air is None or not (air.cells[0] and air.cells[-1]):
        raise DriftError(
            "log-cut-off",
            "the log reaches an end of the detector: pairs of views need air on both sides of it in every view",
        )
    views, cells = sinogram.shape
    across = np.linspace(-1.0, 1.0, cells)
    patterns = np.stack([across, across**2])
    own = air.cells
    count, means = int(own.sum()), patterns[:, own].mean(axis=1)
    # Least squares with a level of each view: slope and curvature come from what is left without the levels.
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
    settled : bool
        Whether they came to rest inside the reach.
    """

    vector: FloatArray
    covariance: FloatArray
    distance_sensitivity: FloatArray
    chi_squared: float
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
        white = self._whitening(start)
        vector, settled = start, False
        for _ in range(STEPS):
            slopes, differences = white @ self._slopes(vector), white @ self._differences(vector)
            covariance = np.linalg.inv(slopes[:, :2].T @ slopes[:, :2])
            step, sensitivity = (
                -covariance @ slopes[:, :2].T @ differences,
                -covariance @ slopes[:, :2].T @ slopes[:, 2],
            )
            moved = np.clip(vector[:2] + step, low, high)
            small = np.abs(moved - vector[:2]) <= SMALL_STEP * np.sqrt(np.diag(covariance))
            vector = np.append(moved, start[2])
            if small.all():
                settled = bool(((low < moved) & (moved < high)).all())
                break
        left, right = self._sums(vector)
        chi_squared = float(np.sum((white @ (left - right)) ** 2))
        # As wide as what is left asks for; its own uncertainty by Student's t, as for a normal distribution.
        freedom = len(white) - 2
        widened = chi_squared / freedom * (stdtrit(freedom, 0.975) / ndtri(0.975)) ** 2
        residual = float(np.sqrt(np.mean((left - right) ** 2) / np.mean(left**2)))
        return _Fit(vector[:2], widened * covariance, sensitivity, chi_squared, residual, settled)

    def _weights(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the rays of the log's cells in the first and in the second view of each pair, (pairs, cells) each."""
        fan, covered = (each[self.lines.cells] for each in fan_angles(self.scanner, vector))
        # 1 / cos(gamma + delta) = 1 / (cos gamma cos delta (1 - tan gamma tan delta))
        shared = np.outer(1.0 / np.cos(self.pairs.delta), covered / np.cos(fan))
        product = np.outer(np.tan(self.pairs.delta), np.tan(fan))
        return shared / (1.0 - product), shared / (1.0 + product)

    def _sums(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What each pair's first and second view sum up to, (pairs,) each."""
        rays, (first, second) = self.lines.rays[:, self.lines.cells], self._weights(vector)
        left: FloatArray = np.einsum("pc,pc->p", first, rays[self.pairs.first])
        right: FloatArray = np.einsum("pc,pc->p", second, rays[self.pairs.second])
        return left, right

    def _differences(self, vector: FloatArray) -> FloatArray:
        left, right = self._sums(vector)
        return left - right

    def _slopes(self, vector: FloatArray) -> FloatArray:
        """Derivatives of the differences by u_c, tau and SDD, (pairs, 3)."""
        steps = np.diag(DIFFERENCES)
        slopes = [(self._differences(vector + step) - self._differences(vector - step)) / 2.0 for step in steps]
        return np.stack(slopes, axis=1) / DIFFERENCES

    def _whitening(self, vector: FloatArray) -> FloatArray:
        """What makes the differences independent and of variance 1, (at most pairs, pairs)."""
        lines, pairs = self.lines, self.pairs
        weights = self._weights(vector)
        rays, variance = (each[:, lines.cells] for each in (lines.rays, lines.variance))
        size, views, every = pairs.first.size, len(rays), np.arange(pairs.first.size)
        # What moves the differences with a view's gain, with its level, and with a slope and a curvature of all views.
        gains, air = np.zeros((size, views)), np.zeros((size, views + len(lines.air_patterns)))
        for sign, view, own in zip((1.0, -1.0), (pairs.first, pairs.second), weights, strict=True):
            gains[every, view] += sign * np.einsum("pc,pc->p", own, rays[view])
            air[every, view] += sign * own.sum(axis=1)
            air[:, views:] += sign * own @ lines.air_patterns[:, lines.cells].T
        covariance = GAIN**2 * gains @ gains.T + air @ lines.air_covariance @ air.T
        for at in range(views):
            first, second = np.flatnonzero(pairs.first == at), np.flatnonzero(pairs.second == at)
            touched, own = np.append(first, second), np.concatenate([weights[0][first], -weights[1][second]])
            covariance[np.ix_(touched, touched)] += (own * variance[at]) @ own.T
        model = (MODEL * float(np.abs(gains).max())) ** 2
        spread, directions = np.linalg.eigh(covariance)
        new = spread > model
        whitening: FloatArray = (directions[:, new] / np.sqrt(spread[new] + model)).T
        return whitening


def _check_found(scanner: Scanner, fit: _Fit, start: SourceFrame) -> None:
    pitch_mm, deviation_mm = scanner.detector_pitch_mm, math.sqrt(fit.covariance[0, 0])
    if not fit.settled:
        raise DriftError(
            "moved-too-far",
            f"no geometry near the calibrated one (u_c {start.cor_column_mm:.4g} mm) makes the views agree: the log "
            "moved while it was scanned, the calibration is another scanner's, or the geometry moved by more than "
            f"{REACH[0]:.0%} of the detector; calibrate with the phantom",
        )
    if not deviation_mm < pitch_mm:
        raise DriftError(
            "nothing-seen",
            f"pairs of views place the centre of rotation to {deviation_mm:.2g} mm on the detector, which is more than "
            f"a cell of {pitch_mm:.3g} mm: average more rows, or calibrate with the phantom",
        )
