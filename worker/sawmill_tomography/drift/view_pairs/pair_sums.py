"""Sums over rays that any two views of one body have in common, and the sums' errors by noise, gains and air.

The identity and its source are in `view_pairs`.

Motions that disturb a scan: wrong angles, an axis that wobbles, and a log or an axis that slides. A motion is linear
in its amplitude: each view's angle error, and the displacement of the log across and along the beam. How large the
motions are is estimated from the differences of the views themselves (`motion_sizes`), so that a scanner that keeps
still loses nothing to them.
"""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.levelled_rays import LevelledRays
from sawmill_tomography.drift.opposite_rays.paired_rays import fan_angles
from sawmill_tomography.drift.view_pairs.behind_metal import RaysBehindMetal
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS

# RMS amplitude of the angles' error once a turn: an eccentric encoder.
ENCODER_DEG = 0.1
# Standard deviations of the largest motions: the turn's error over the scan, the axis's amplitudes once and twice a
# turn, and the way that log or axis slides.
TURN_DEG, WOBBLE_MM, SLIDE_MM = 3.0, 0.2, 0.5
# Sizes of each kind of motion that are compared, as shares of the largest, and their probabilities before a scan: 1 / s
# as in the tail of a half-Cauchy distribution (Gelman 2006, Bayesian Analysis 1, 515), and so large together that the
# RMS is a sound scanner's, 0.02 mm of wobble.
SIZES = np.array([0.0, 0.03, 0.1, 0.3, 1.0])
PROBABILITIES = np.append(0.7, 0.3 / SIZES[1:] / np.sum(1.0 / SIZES[1:]))
# Motions are named if they are this number of times as likely as none, as a natural logarithm.
FOUND = 8.0


class MotionSizes(NamedTuple):
    """Estimated standard deviations of motions, and whether there are any."""

    shares: FloatArray  # (motions,): standard deviations as shares of the largest
    found: bool  # True if motions are far more likely than none


class ScanMotions(NamedTuple):
    """Motions, each with an amplitude of one of its largest standard deviations."""

    turned_rad: FloatArray  # (views, motions): turn of the log beyond the stated angles
    moved_mm: FloatArray  # (2, views, motions)
    kinds: tuple[str, ...]  # the kind of each motion; motions of a kind have one size

    def described(self, amplitudes: FloatArray) -> str:
        """Return how far the log moved with these amplitudes, (motions,), and what to check, in one sentence."""
        moved_mm = float(np.hypot(*(self.moved_mm @ amplitudes)).max())
        wrong_deg = math.degrees(float(np.abs(self.turned_rad @ amplitudes).max()))
        return (
            f"during the scan the log moved by up to {moved_mm:.2g} mm and its angles went wrong by up to "
            f"{wrong_deg:.2g} degrees, which was fitted: check the turntable's bearing, the clamps and the angles"
        )

    @property
    def turns(self) -> NDArray[np.bool_]:
        """True for motions that turn the log, (motions,)."""
        return np.asarray(np.any(self.turned_rad != 0.0, axis=0))

    @classmethod
    def encoder(cls, angles_rad: FloatArray) -> "ScanMotions":
        """Return the angles' error once a turn by `ENCODER_DEG`, as cosine and sine."""
        turned = math.radians(ENCODER_DEG) * _waves(angles_rad, 1)
        return cls(turned, np.zeros((2, *turned.shape)), ("encoder", "encoder"))

    @classmethod
    def of_scan(cls, angles_rad: FloatArray, times: FloatArray) -> "ScanMotions":
        """Return the motions of views (views,) taken at these times, from -0.5 to 0.5 over the scan.

        A slide is of the log, in two directions that turn with it, or of the axis, across and along the beam.
        """
        time = times[:, None]
        turn = math.radians(TURN_DEG) * time
        waves = np.hstack([_waves(angles_rad, order) for order in (1, 2)])
        wobble: FloatArray = WOBBLE_MM * np.stack([np.hstack([waves, 0.0 * waves]), np.hstack([0.0 * waves, waves])])
        with_log, still = time * _waves(angles_rad, 1), 0.0 * time
        across, along = np.hstack([with_log, time, still]), np.hstack([with_log[:, ::-1] * [-1.0, 1.0], still, time])
        moved = np.concatenate([np.zeros((2, *turn.shape)), wobble, SLIDE_MM * np.stack([across, along])], axis=2)
        kinds = ("turn",) + ("wobble",) * wobble.shape[2] + ("slide",) * across.shape[1]
        return cls(np.pad(turn, ((0, 0), (0, len(kinds) - 1))), moved, kinds)


def _waves(angles_rad: FloatArray, order: int) -> FloatArray:
    """Return cosine and sine, (views, 2)."""
    return np.stack([np.cos(order * angles_rad), np.sin(order * angles_rad)], axis=1)


def motion_sizes(residual: FloatArray, known: FloatArray, motions: FloatArray, kinds: tuple[str, ...]) -> MotionSizes:
    """Estimate the motions' sizes from whitened differences by their restricted likelihood.

    Every combination of sizes counts with its likelihood (Harville 1977, Journal of the American Statistical
    Association 72, 320), the noise's variance being unknown: uncertain sizes enlarge the covariance.

    `residual` (differences,). `known` (differences, columns): orthonormal columns that explain anything: the geometry's
    slopes and the views' gains. `motions` (differences, motions): change of the differences by the motions.
    """
    names = list(dict.fromkeys(kinds))
    residual, motions = residual - known @ (known.T @ residual), motions - known @ (known.T @ motions)
    free = len(residual) - known.shape[1]
    levels = np.array(list(product(range(SIZES.size), repeat=len(names))))
    shares = SIZES[levels][:, [names.index(kind) for kind in kinds]]
    gram = np.eye(len(kinds)) + shares[:, :, None] * (motions.T @ motions) * shares[:, None, :]
    right = shares * (motions.T @ residual)
    explained = np.einsum("hm,hm->h", right, np.linalg.solve(gram, right[..., None])[..., 0])
    left = np.maximum(float(residual @ residual) - explained, np.finfo(float).tiny)
    likelihoods = -0.5 * np.linalg.slogdet(gram)[1] - 0.5 * free * np.log(left)
    # The first combination is no motion at all.
    weights = PROBABILITIES[levels].prod(axis=1) * np.exp(likelihoods - likelihoods.max())
    weights /= weights.sum()
    return MotionSizes(np.sqrt(weights @ shares**2), bool(likelihoods.max() - likelihoods[0] > FOUND))


# Smallest angle between a pair's line L and the rays through the log, rad: there a weight is 1 / 0.06.
EDGE_RAD = 0.06
# More pairs cost time. If there are too many, those far apart are kept: u_c moves their sums most, by tan(delta).
MOST_PAIRS = 400
FARTHEST = 0.5
# Standard deviation of a view's gain, as a share, after the air has been evened out.
GAIN = 0.005
# Curvature of the line integrals, as a share of the largest ray, as a square and as a cube of the integrals: from beam
# hardening, and from -ln of few counts.
BENT = 0.1
# Combinations of sums whose noise is below this share of a sum add no information: pairs repeat each other, and their
# residual is rounding.
MODEL = 3e-7
# Steps of u_c (mm), tau (rad) and SDD (mm), for numerical derivatives of the sums, which are smooth in them.
DIFFERENCES = (0.05, 1e-4, 1.0)
# Decimals of delta (rad) beyond which separations of views are the same.
SAME = 9


@dataclass(frozen=True, eq=False)
class ViewPairs:
    """First and second view of each pair, each (pairs,), and the index of the pair's separation."""

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    separation: NDArray[np.intp]
    delta: FloatArray  # (separations,): half the angle between two views. Views at even steps have few separations

    @classmethod
    def of(cls, angles_rad: FloatArray, farthest_rad: float) -> "ViewPairs":
        """Select the pairs whose line misses a log of this half fan angle, evenly thinned to `MOST_PAIRS`."""
        apart = np.mod(angles_rad - angles_rad[:, None], TAU)
        first, second = np.nonzero((apart > 1e-6) & (apart < math.pi - 2.0 * (farthest_rad + EDGE_RAD)))
        delta = 0.5 * apart[first, second]
        if first.size > MOST_PAIRS:
            far = delta >= np.sort(delta)[-max(MOST_PAIRS, int(FARTHEST * delta.size))]
            first, second, delta = first[far], second[far], delta[far]
            # Each view keeps the same number of partners, spread over all separations.
            order = np.lexsort((delta, first))
            kept = order[np.linspace(0, order.size - 1, MOST_PAIRS).astype(int)]
            first, second, delta = first[kept], second[kept], delta[kept]
        separations, separation = np.unique(delta.round(SAME), return_inverse=True)
        return cls(first, second, separation, separations)


@dataclass(frozen=True, eq=False)
class PairSums:
    """The sums of a scan's pairs of views as functions of (u_c, tau, SDD)."""

    scanner: Scanner
    lines: LevelledRays
    metal: RaysBehindMetal
    pairs: ViewPairs
    angles_rad: FloatArray
    source_distance_mm: float

    @classmethod
    def of(
        cls,
        scanner: Scanner,
        lines: LevelledRays,
        metal: RaysBehindMetal,
        angles_rad: FloatArray,
        start: FloatArray,
        source_distance_mm: float,
    ) -> "PairSums":
        """Select all pairs whose line misses the log, with (u_c, tau, SDD) at the start."""
        fan, _ = fan_angles(scanner, start)
        pairs = ViewPairs.of(angles_rad, float(np.abs(fan[lines.cells]).max()))
        if pairs.first.size < FEWEST_PAIRED_VIEWS:
            raise DriftError(
                "sparse-views",
                f"of the views only {pairs.first.size} pairs stand far enough apart and not opposite each other: "
                "spread them over the turn",
            )
        return cls(scanner, lines, metal, pairs, angles_rad, source_distance_mm)

    def turned(self, turned_rad: FloatArray) -> "PairSums":
        """Return the sums of the same pairs, each view turned beyond its angle, (views,)."""
        angles = self.angles_rad + turned_rad
        delta = 0.5 * np.mod(angles[self.pairs.second] - angles[self.pairs.first], TAU)
        separations, separation = np.unique(delta.round(SAME), return_inverse=True)
        return replace(self, pairs=replace(self.pairs, separation=separation, delta=separations), angles_rad=angles)

    def _weights(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weights of the rays of the log's cells in first and in second views, (separations, cells) each."""
        fan, covered = (each[self.lines.cells] for each in fan_angles(self.scanner, vector))
        delta = self.pairs.delta
        # 1 / cos(gamma + delta) = 1 / (cos gamma cos delta (1 - tan gamma tan delta))
        shared = np.outer(1.0 / np.cos(delta), covered / np.cos(fan))
        product = np.outer(np.tan(delta), np.tan(fan))
        return shared / (1.0 - product), shared / (1.0 + product)

    def at(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the sums of each pair's first and second view, (pairs,) each."""
        return self._picked(self._weights(vector), self.lines.rays)

    def differences(self, vector: FloatArray) -> FloatArray:
        """Return the first view's sum less the second's, (pairs,)."""
        left, right = self.at(vector)
        return left - right

    def slopes(self, vector: FloatArray, differences: FloatArray, unknowns: int) -> FloatArray:
        """Return the derivatives, (pairs, unknowns), of `differences` at `vector` by the first of u_c, tau and SDD."""
        steps = np.diag(DIFFERENCES)[:unknowns]
        slopes = [(self.differences(vector + step) - differences) / step.sum() for step in steps]
        return np.stack(slopes, axis=1)

    def whitening(self, vector: FloatArray, patterns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a matrix that whitens the differences, (at most pairs, pairs), and the effect of gains (pairs, views).

        The effect of gains is the change of the differences by a gain of `GAIN` of each view.

        `patterns` (pairs, patterns): further changes of the differences, each with an amplitude of standard deviation
        1.
        """
        lines, pairs = self.lines, self.pairs
        weights = self._weights(vector)
        size, views, every = pairs.first.size, len(lines.rays), np.arange(pairs.first.size)
        # Changes of the differences with a view's gain, with its level, and with the patterns of all views.
        gains, air = np.zeros((size, views)), np.zeros((size, views + len(lines.air_patterns)))
        errors, of_view = self.metal.errors[:, lines.cells], self.metal.of_view
        behind = np.zeros((size, of_view.size))
        for sign, view, own in zip((1.0, -1.0), (pairs.first, pairs.second), weights, strict=True):
            gains[every, view] += sign * (own @ lines.rays.T)[pairs.separation, view]
            air[every, view] += sign * own.sum(axis=1)[pairs.separation]
            air[:, views:] += sign * (own @ lines.air_patterns.T)[pairs.separation]
            behind += sign * (own @ errors.T)[pairs.separation] * (view[:, None] == of_view)
        # A gain common to all views changes nothing; its effect would be the differences themselves.
        gains = GAIN * (gains - gains.mean(axis=1, keepdims=True))
        covariance = gains @ gains.T + patterns @ patterns.T + air @ lines.air_covariance @ air.T + behind @ behind.T
        covariance += self.common_covariance(vector)
        for at in range(views):
            first, second = np.flatnonzero(pairs.first == at), np.flatnonzero(pairs.second == at)
            touched = np.append(first, second)
            own = np.concatenate([weights[0][pairs.separation[first]], -weights[1][pairs.separation[second]]])
            covariance[np.ix_(touched, touched)] += (own * lines.variance[at]) @ own.T
        model = (MODEL / GAIN * float(np.abs(gains).max())) ** 2
        spread, directions = np.linalg.eigh(covariance)
        new = spread > model
        whitening: FloatArray = (directions[:, new] / np.sqrt(spread[new] + model)).T
        return whitening, gains

    def common_covariance(self, vector: FloatArray) -> FloatArray:
        """Return the covariance of the differences, (pairs, pairs), by what the flat field leaves in every view."""
        first, second = self._weights(vector)
        same, separation = first - second, self.pairs.separation
        covariance: FloatArray = same @ self.lines.common_covariance @ same.T
        return covariance[np.ix_(separation, separation)]

    def bends(self, vector: FloatArray) -> FloatArray:
        """Return the change of the differences by line integrals bent by `BENT`, as squares and as cubes, (pairs, 2).

        Powers of the sums remove the views' gains. Noise moves bends and differences alike: the noise's part in the
        bends, predicted from the differences, which near the truth are only noise and gains, is subtracted.
        """
        weights = self._weights(vector)
        rays, variance = self.lines.rays, self.lines.variance
        share = rays / float(rays.max())
        squared = weights[0] ** 2, weights[1] ** 2
        sums, noise = self._picked(weights, rays), self._picked(squared, variance)
        mean, bends = 0.5 * (sums[0] + sums[1]), []
        for power in (2, 3):
            bent = self._picked(weights, rays * share ** (power - 1))
            slopes = self._picked(squared, variance * power * share ** (power - 1))
            first, second = (own * (mean / each) ** power for own, each in zip(bent, sums, strict=True))
            moved = (slopes[0] + slopes[1]) / (noise[0] + noise[1]) - power * 0.5 * (first + second) / mean
            bends.append(first - second - moved.mean() * (sums[0] - sums[1]))
        return BENT * np.stack(bends, axis=1)

    def moved(self, vector: FloatArray, motions: ScanMotions) -> FloatArray:
        """Return the change of the differences by motions of the scan, (pairs, motions).

        The views of a pair are farther apart than stated by the difference of their angle errors. A body that moves is
        a source that moves the other way: the line L through both sources turns by the change of its normal component
        over its length. The changes are shares of the sums, which the views' gains do not affect.
        """
        weights, pairs = self._weights(vector), self.pairs
        fan, _ = fan_angles(self.scanner, vector)
        fan, delta = fan[self.lines.cells], pairs.delta[:, None]
        sums = self._picked(weights, self.lines.rays)
        slopes = self._picked((weights[0] * np.tan(fan + delta), weights[1] * np.tan(fan - delta)), self.lines.rays)
        left, right = (slope / own for slope, own in zip(slopes, sums, strict=True))
        mean = 0.5 * (sums[0] + sums[1])[:, None]
        farther = 0.5 * (motions.turned_rad[pairs.second] - motions.turned_rad[pairs.first])
        across, along = motions.moved_mm
        wider = np.tan(pairs.delta)[pairs.separation][:, None]
        line = (along[pairs.first] - along[pairs.second]) / wider - across[pairs.first] - across[pairs.second]
        line /= 2.0 * self.source_distance_mm
        return np.asarray(-mean * ((left + right)[:, None] * farther + (left - right)[:, None] * line))

    def _picked(self, weights: tuple[FloatArray, FloatArray], values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return each pair's sums of values (views, cells) of the first and of the second view, (pairs,) each.

        Every separation's weights are multiplied with every view in one matrix product, then the pairs are picked.
        """
        pairs, (first, second) = self.pairs, (each @ values.T for each in weights)
        return first[pairs.separation, pairs.first], second[pairs.separation, pairs.second]
