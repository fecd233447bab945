"""Disturbances of the turn: an eccentric encoder and a wobbling bearing, from pairs of opposite rays.

The view that reports the angle phi is at phi + delta(phi), and the log is displaced across the beam by w(phi). A
ray of the fan angle gamma then belongs to the line of the angles chi + delta and gamma - w / R. Both are sums of the
first and second harmonic of phi. If they are not fitted, they look like a change of u_c and tau.

Detection of a log that moved while it was scanned, from its pairs of opposite rays. A log that shifts by t between
two views shifts the rays after it by -(dP/ds) t . n(chi), s the distance of a ray from the COR and n its normal; a
pair of rays shows this only where one was measured before and the other after. Each view is tried as the first after
the shift (docs/understand/verdict.md#a-log-beside-the-phantom).

Gain and offset of each view drift with the source or the flat field.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import Disturbance, LogMovement
from sawmill_tomography.drift.opposite_rays.opposite_rays import Solution
from sawmill_tomography.drift.opposite_rays.paired_rays import fan_angles
from sawmill_tomography.effect_priors import PRIORS, SIZES, Prior
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner
from sawmill_vocabulary import Adjustment

# A disturbance is found if it is e^5 times as likely as none: at even odds one of 84 simulated sound scans had one.
FOUND = 5.0
# The largest log's radius: at it the encoder's error is in mm, as in its prior.
RIM_MM = 150.0
# Number of rounds that search for disturbances: each round takes the one that explains most.
ROUNDS = 6


DISTURBANCES = (
    Disturbance("encoder", 1),
    Disturbance("encoder", 2),
    Disturbance("bearing", 1),
    Disturbance("bearing", 2),
)


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Disturbances as angles, by the angle in the sense of rotation used: delta, and - w / R of the bearing."""

    # (disturbances, 2): cosine and sine amplitudes, rad
    values: FloatArray = field(default_factory=lambda: np.zeros((len(DISTURBANCES), 2)))

    def plus(self, estimate: "DisturbanceEstimate") -> "Harmonics":
        """Return the harmonics with one more estimate added."""
        values = self.values.copy()
        values[DISTURBANCES.index(estimate.disturbance)] += estimate.value
        return Harmonics(values)

    def at(self, part: str, phi: FloatArray) -> FloatArray:
        """Return the angle of the encoder's or the bearing's disturbance at the angles phi (any shape), rad."""
        terms = [
            value @ np.stack([np.cos(each.order * phi), np.sin(each.order * phi)]).reshape(2, -1)
            for each, value in zip(DISTURBANCES, self.values, strict=True)
            if each.part == part
        ]
        return np.asarray(np.sum(terms, axis=0).reshape(phi.shape))

    def amplitudes(self, source_distance_mm: float) -> dict[Disturbance, float]:
        """Return the amplitudes that are not 0: degrees for the encoder, mm for the bearing."""
        size = np.hypot(*self.values.T)
        return {
            each: math.degrees(a) if each.part == "encoder" else float(a * source_distance_mm)
            for each, a in zip(DISTURBANCES, size, strict=True)
            if a > 0.0
        }


@dataclass(frozen=True, eq=False)
class DisturbanceEstimate:
    """A disturbance fitted with the geometry."""

    disturbance: Disturbance
    prior: Prior  # the calibration's, with sizes in rad
    value: FloatArray  # (2,): cosine and sine amplitudes, rad
    covariance: FloatArray  # (2, 2)
    sensitivity: FloatArray  # (unknowns, 2): change of the geometry's free unknowns per rad of either amplitude

    @property
    def evidence(self) -> FloatArray:
        """Logarithm of odds times likelihood of each size against no disturbance, (SIZES,)."""
        variances, axes = np.linalg.eigh(self.covariance)
        wider = variances + self.prior.sizes[:, None] ** 2
        gain = (self.value @ axes) ** 2 * (1.0 / variances - 1.0 / wider) - np.log(wider / variances)
        return np.asarray(math.log(self.prior.odds / (1.0 - self.prior.odds) / SIZES) + 0.5 * gain.sum(axis=1))

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds of this disturbance, of any size, against none."""
        return float(np.logaddexp.reduce(self.evidence))

    @property
    def moved(self) -> FloatArray:
        """What the disturbance, if it is not found, may add to the unknowns' error (unknowns, unknowns).

        It is the second moment of the amplitudes' posterior over all sizes. The lowest stands for 0 and what is below.
        """
        evidence = self.evidence
        evidence[0] = np.logaddexp(evidence[0], 0.0)
        weights = np.exp(evidence - np.logaddexp.reduce(evidence))
        variances, axes = np.linalg.eigh(self.covariance)
        shares = 1.0 / (1.0 + variances / self.prior.sizes[:, None] ** 2)
        means, towards = shares * (self.value @ axes), self.sensitivity @ axes
        return np.asarray(towards @ (np.diag(weights @ shares * variances) + (weights * means.T) @ means) @ towards.T)


def strongest(estimates: Sequence[DisturbanceEstimate], found: Harmonics) -> DisturbanceEstimate | None:
    """Return the likeliest disturbance, of any size of its prior with what of it was found; None if none is found."""
    possible = [
        each
        for each in estimates
        if np.hypot(*found.plus(each).values[DISTURBANCES.index(each.disturbance)]) >= each.prior.low
    ]
    best = max(possible, key=lambda each: each.log_odds, default=None)
    return best if best is not None and best.log_odds > FOUND else None


def undetected_covariance(solution: Solution, estimates: Sequence[DisturbanceEstimate]) -> FloatArray:
    """Return the covariance that undetected disturbances may add to the error of (u_c, tau, SDD), (3, 3)."""
    covariance = np.zeros((3, 3))
    covariance[solution.free, solution.free] = sum(each.moved for each in estimates)
    return covariance


def estimates_of(solution: Solution) -> list[DisturbanceEstimate]:
    """Fit each disturbance alone together with the geometry; leave out disturbances that the pairs do not show."""
    slopes = np.concatenate([_weights(each, solution.pairs.gamma, solution.pairs.chi) for each in DISTURBANCES])
    # An error of the encoder moves rays by chi, one of the bearing by gamma.
    chosen = [1 if each.part == "encoder" else 0 for each in DISTURBANCES for _ in range(2)]
    rays = solution.rays.with_unknowns(solution.derivatives, chosen, slopes)
    geometry = list(range(3))[solution.free]
    priors = {
        "encoder": PRIORS[Adjustment.ENCODER].in_units(RIM_MM),
        "bearing": PRIORS[Adjustment.WOBBLE].in_units(solution.pairs.scanner.source_to_cor_mm),
    }
    estimates = []
    for at, each in enumerate(DISTURBANCES):
        unknowns, inside = [*geometry, 3 + 2 * at, 4 + 2 * at], len(geometry)
        covariance = rays.covariance(unknowns, corrected=True)
        if np.isfinite(covariance).all():
            gram = rays.gram(corrected=True)[unknowns][:, unknowns]
            step = -np.linalg.solve(gram, rays.scores.sum(axis=0)[unknowns])[inside:]
            moves = np.asarray(-np.linalg.solve(gram[:inside, :inside], gram[:inside, inside:]), np.float64)
            estimates.append(DisturbanceEstimate(each, priors[each.part], step, covariance[inside:, inside:], moves))
    return estimates


def _weights(each: Disturbance, gamma: FloatArray, chi: FloatArray) -> FloatArray:
    """Return the weights of a disturbance's cosine and sine in its derivative, (2, pairs, chi).

    The sign convention is an unknown's of the geometry: correcting the disturbance subtracts this from the differences.
    """
    here, there = np.exp(1j * each.order * gamma), np.exp(1j * each.order * (math.pi - gamma))
    waves = np.outer(there - here if each.part == "encoder" else -here - there, np.exp(1j * each.order * chi))
    return np.stack([waves.real, waves.imag])


def undisturbed(
    scanner: Scanner, vector: FloatArray, sinogram: FloatArray, angles_rad: FloatArray, harmonics: Harmonics
) -> tuple[FloatArray, FloatArray]:
    """Correct sinogram (views, cells) and angles (views,), in this sense of rotation, for disturbances of the turn.

    A sample at phi and gamma belongs to the view phi + delta + swing and the fan angle gamma + swing, swing = - w / R:
    the direction chi = phi - gamma of the ray stays.
    """
    swing = harmonics.at("bearing", angles_rad)
    angles = angles_rad + harmonics.at("encoder", angles_rad) + swing
    return shifted(scanner, vector, sinogram, swing) if swing.any() else sinogram, angles


def shifted(scanner: Scanner, vector: FloatArray, sinogram: FloatArray, swing: NDArray[np.float64]) -> FloatArray:
    """Move each view along the detector by its swing, by cubic splines."""
    fan, covered = fan_angles(scanner, vector)
    cells = np.arange(fan.size) - swing[:, None] / covered
    views = np.broadcast_to(np.arange(len(sinogram))[:, None], cells.shape)
    return np.asarray(scipy.ndimage.map_coordinates(sinogram, [views, cells], order=3, mode="nearest"), np.float64)


# A jump this close to the first or the last view, as a share of the views and in views, has too few pairs to be seen.
MARGIN, FEWEST_BESIDE = 1 / 16, 3


def log_movement(solution: Solution, angles_rad: FloatArray, source_distance_mm: float) -> LogMovement:
    """Estimate the jump that explains most of the pairs' differences.

    `angles_rad` (views,): angles in the order in which the views were taken, in the fit's sense of rotation.
    """
    jumps = _Jumps(solution, angles_rad, source_distance_mm)
    beside = max(math.ceil(MARGIN * angles_rad.size), FEWEST_BESIDE)
    tried = np.arange(beside, angles_rad.size - beside)
    right, least, cross = jumps.normal_equations(tried)
    shifts = np.linalg.solve(least, right[..., None])[..., 0]
    best = int(np.argmax(np.einsum("kj,kj->k", right, shifts)))
    shift = shifts[best]
    covariance = jumps.covariance(int(tried[best]), shift, least[best], cross[best])
    return LogMovement(int(tried[best]), math.hypot(*shift), float(shift @ np.linalg.solve(covariance, shift)))


class _Jumps:
    """The pairs' differences, and their change by a jump of 1 mm along x or y.

    Shapes are (pairs, chi). As in the fit of the geometry, instruments are derivatives blurred twice over chi, and the
    scores of every chi are independent.
    """

    def __init__(self, solution: Solution, angles_rad: FloatArray, source_distance_mm: float) -> None:
        pairs, rays = solution.pairs, solution.rays
        near, opposite = (_taken(angles, angles_rad) for angles in pairs.views_of())
        self._first, self._last, self._views = np.minimum(near, opposite), np.maximum(near, opposite), angles_rad.size
        # The distance from the COR is s = R sin gamma.
        by_s = 1.0 / (source_distance_mm * np.cos(pairs.gamma))[:, None]
        chi = np.arange(near.shape[1]) * TAU / near.shape[1]
        normal = np.sign(near - opposite) * by_s * np.stack([np.cos(chi), np.sin(chi)])[:, None, :]
        derivatives = solution.derivatives
        slope, instrument = derivatives.plain[0], derivatives.blurred[0]
        self._difference = rays.difference
        self._jump, self._jump_instrument = normal * slope, normal * instrument
        self._known, self._known_instrument = rays.slopes[solution.free], rays.instruments[solution.free]
        self._gram = np.einsum("apc,bpc->ab", self._known_instrument, self._known)

    def normal_equations(self, tried: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sum the normal equations of a jump at each view tried, without the part that the geometry explains.

        `right` (tried, 2), `matrix` (tried, 2, 2), products with the derivatives (tried, 2, unknowns).
        """
        right = self._sums(self._jump_instrument * self._difference, tried)
        own = self._sums(self._jump_instrument[:, None] * self._jump, tried)
        cross = self._sums(self._jump_instrument[:, None] * self._known, tried)
        back = self._sums(self._known_instrument[:, None] * self._jump, tried)
        # Differences have no mean over chi.
        means = self._sums_of_pairs(self._jump_instrument, tried), self._sums_of_pairs(self._jump, tried)
        own -= np.einsum("kip,kjp->kij", *means) / self._difference.shape[1]
        return right, own - cross @ np.linalg.solve(self._gram, back), cross

    def covariance(self, view: int, shift: FloatArray, matrix: FloatArray, cross: FloatArray) -> FloatArray:
        """Return the covariance of the shift (2, 2), robust to unequal noise (White 1980)."""
        active = (self._first < view) & (view <= self._last)
        explained = np.linalg.solve(self._gram, cross.T).T
        instrument = self._jump_instrument * active - np.einsum("ja,apc->jpc", explained, self._known_instrument)
        unexplained = self._jump * active - np.einsum("ja,apc->jpc", explained, self._known)
        residual = self._difference - np.einsum(
            "j,jpc->pc", shift, unexplained - unexplained.mean(axis=-1, keepdims=True)
        )
        scores = np.einsum("jpc,pc->cj", instrument, residual)
        bread = np.linalg.inv(matrix)
        return np.asarray(bread @ (scores.T @ scores) @ bread.T)

    def _sums(self, values: FloatArray, tried: NDArray[np.intp]) -> FloatArray:
        """Sum values (..., pairs, chi) where a jump moves one ray of a pair alone, (tried, ...)."""
        return self._counted(values, self._first, self._last, self._views + 1)[tried]

    def _sums_of_pairs(self, values: FloatArray, tried: NDArray[np.intp]) -> FloatArray:
        """Sum values (..., pairs, chi) over chi where a jump moves one ray of a pair alone, (tried, ..., pairs)."""
        pairs, size = len(self._first), self._views + 1
        at = np.arange(pairs)[:, None] * size
        sums = self._counted(values, at + self._first, at + self._last, pairs * size)
        # A sum that starts in a pair ends in the same pair: earlier pairs add nothing.
        return np.moveaxis(sums.reshape(pairs, size, -1)[:, tried], 0, -1)

    @staticmethod
    def _counted(values: FloatArray, first: NDArray[np.intp], last: NDArray[np.intp], size: int) -> FloatArray:
        """Sum values (..., pairs, chi) that count from after the first place up to the last, (size, ...)."""
        begun, ended = (first + 1).ravel(), (last + 1).ravel()
        rows = values.reshape(-1, begun.size)
        sums = np.cumsum([np.bincount(begun, row, size) - np.bincount(ended, row, size) for row in rows], axis=1)
        return np.asarray(sums.T.reshape(size, *values.shape[:-2]))


def _taken(angles: FloatArray, angles_rad: FloatArray) -> NDArray[np.intp]:
    """Return the number of the view nearest to each angle, in the order in which the views were taken."""
    wrapped = np.mod(angles_rad, TAU)
    order = np.argsort(wrapped, kind="stable")
    turn = wrapped[order]
    middles = 0.5 * (turn + np.append(turn[1:], turn[0] + TAU))
    return np.asarray(order[np.searchsorted(middles, np.mod(angles - turn[0], TAU) + turn[0]) % turn.size])


# Opposite rays are compared on samples this many cells apart, each a Gaussian mean this wide: nearly independent.
SPACING_CELLS, WIDTH_CELLS = 5.0, 1.5
# Weights of cells farther away are below 1e-15.
REACH_CELLS = 13
# Each round removes half of the residual: the opposite rays contain as much of it as the rays.
GAIN_ROUNDS = 8
# Gain and offset of the views must explain this number of times more of the differences than noise would
# (benchmarks/unsteady.py at 3ab7f653).
EVIDENCE = 3.0


@dataclass(frozen=True, eq=False)
class ViewGain:
    """Gain of each view, (views,), mean 1, and the offset added after the gain, (views,), mean 0."""

    gain: FloatArray
    offset: FloatArray

    @property
    def done(self) -> str:
        """The correction, in one sentence for people."""
        return f"the views' gain scattered by {np.std(self.gain):.2%} and was evened out"

    def removed(self, sinogram: FloatArray) -> FloatArray:
        """Return the sinogram (views, cells) without gain and offset."""
        return (sinogram - self.offset[:, None]) / self.gain[:, None]


def view_gain(sinogram: FloatArray, fan_rad: FloatArray, *, reversed_turn: bool) -> ViewGain | None:
    """Fit each view's gain and offset by p(phi, gamma) = p(phi + pi - 2 gamma, -gamma); None where noise explains them.

    A gain that varies with an even harmonic of the turn is the same in opposite views and stays.

    `sinogram` (views, cells): line integrals at equidistant angles over the full turn. `fan_rad` (cells,): fan angle of
    each cell, ascending through zero.
    """
    gamma, means = _means(fan_rad)
    rays = means @ np.ascontiguousarray(sinogram.T)
    views = len(sinogram)
    shift = (math.pi - 2.0 * gamma) * (-1.0 if reversed_turn else 1.0)
    phase = np.exp(1j * np.outer(shift, np.arange(views // 2 + 1)))
    estimate = ViewGain(np.ones(views), np.zeros(views))
    for done in range(GAIN_ROUNDS):
        corrected = rays - estimate.offset
        corrected /= estimate.gain
        opposite = scipy.fft.irfft(scipy.fft.rfft(corrected)[::-1] * phase, views)
        gain, offset = _line(opposite, corrected)
        if done == 0 and _evidence(opposite, corrected, gain, offset) < EVIDENCE:
            return None
        gain = 1.0 + 0.5 * (gain - gain.mean())
        offset = 0.5 * (offset - offset.mean())
        estimate = ViewGain(estimate.gain * gain, estimate.offset + estimate.gain * offset)
    return estimate


def _means(fan_rad: FloatArray) -> tuple[FloatArray, "scipy.sparse.csr_array"]:
    """Return fan angles symmetric about zero, (samples,), and the weights of their means, (samples, cells)."""
    spacing = float(np.median(np.diff(fan_rad)))
    count = int(min(-fan_rad[0], fan_rad[-1]) / (SPACING_CELLS * spacing))
    half = (np.arange(count) + 0.5) * SPACING_CELLS * spacing
    gamma = np.concatenate([-half[::-1], half])
    near = np.searchsorted(fan_rad, gamma)[:, None] + np.arange(-REACH_CELLS, REACH_CELLS)
    inside = (near >= 0) & (near < fan_rad.size)
    near = near.clip(0, fan_rad.size - 1)
    weights = inside * np.exp(-0.5 * ((fan_rad[near] - gamma[:, None]) / (WIDTH_CELLS * spacing)) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    borders = np.arange(gamma.size + 1) * near.shape[1]
    return gamma, scipy.sparse.csr_array((weights.ravel(), near.ravel(), borders), shape=(gamma.size, fan_rad.size))


def _line(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return slope and intercept of y over x (samples, views) in each view."""
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    x = x - x_mean
    slope = np.einsum("sv,sv->v", x, y) / np.einsum("sv,sv->v", x, x)
    return slope, y_mean - slope * x_mean


def _evidence(x: FloatArray, y: FloatArray, slope: FloatArray, intercept: FloatArray) -> float:
    """Return the sum of squares that the lines explain beyond y = x.

    The sum is divided by the two unknowns, in units of the residual for each degree of freedom.
    """
    residual = float(np.sum((y - slope * x - intercept) ** 2))
    return (float(np.sum((y - x) ** 2)) - residual) / residual * ((len(x) - 2) / 2)
