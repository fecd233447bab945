"""Opposite rays of a full turn as functions of (u_c, tau, SDD), and the fit to their differences.

chi is the direction of a ray in the plane, as the angle of a parallel beam (docs/understand/drift.md#dense-scans).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.drift.opposite_rays.full_turn import ComplexArray, FullTurn
from sawmill_tomography.drift.opposite_rays.paired_rays import Derivatives, PairedRays, fan_angles, is_definite
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner

# Gaussians are cut off here, in widths.
CUT_OFF = 4.5
# Pairs are this many widths of the blur apart, beyond which it leaves 0.002 of the power; closer where there would be
# fewer pairs than this, but not closer than cells.
PAIR_STEP, MANY_PAIRS = 1.25, 40
STEPS = 40
# A step below this share of the standard deviations is the last one, and the rays before it are near enough: another
# step would be a hundred times shorter.
SMALL_STEP = 0.1
# A vector within this share of the standard deviations of another is as good.
NEAR = 0.1
# A pair is left out when a ray of it lies within this many widths of the blur of a cell without data, unless that would
# be more than this share of the pairs.
CELL_REACH, MOST_TOUCHED = 3.0, 0.5
# Samples left out affect this number of widths of the blur to either side: their filled values are near the truth.
SAMPLE_REACH = 1.0
# Slices of (u_c, tau, SDD): the unknowns that are fitted.
ALL_THREE, WITHOUT_DISTANCE = slice(0, 3), slice(0, 2)


class Pairs:
    """Paired rays as a function of (u_c, tau, SDD).

    In the Fourier domain of the views the turn by gamma is an exact phase, so views are never interpolated. The blur
    over cells is even in gamma at fixed chi, so both rays of a pair are blurred alike. The constant harmonic is left
    out: a part common to all views (errors of the flat field, rings, a background) cannot look like drift.
    """

    def __init__(self, scanner: Scanner, turn: FullTurn, start: FloatArray, blur: tuple[float, float]) -> None:
        self.scanner, self._turn = scanner, turn
        self._orders = np.arange(turn.views // 2 + 1)
        self._blur = np.exp(-0.5 * (blur[0] * self._orders * TAU / turn.views) ** 2)
        fan, _ = fan_angles(self.scanner, start)
        spacing = float(np.median(np.diff(fan)))
        self._width = blur[1] * spacing
        self._taps = np.arange(-math.ceil(1.1 * CUT_OFF * blur[1]), math.ceil(1.1 * CUT_OFF * blur[1]) + 1)
        room = min(-fan[0], fan[-1]) - 4.0 * self._width
        step = max(spacing, min(PAIR_STEP * self._width, room / MANY_PAIRS))
        pairs = int(room / step)
        if pairs < 8:
            raise DriftError(
                "outside-detector",
                f"the centre of rotation falls on u = {start[0]:.4g} mm, at the detector's edge or beyond: "
                "opposite rays need detector on both sides of it",
            )
        self.gamma = (np.arange(pairs) + 0.5) * step
        self.chi = np.arange(turn.views) * TAU / turn.views
        self._used = self._measured(fan)

    def views_of(self) -> tuple[FloatArray, FloatArray]:
        """Return the angle of the view that measured each ray, and each opposite ray, (pairs, chi)."""
        return self.chi + self.gamma[:, None], self.chi + math.pi - self.gamma[:, None]

    def _measured(self, fan: FloatArray) -> NDArray[np.bool_]:
        """Select pairs without a ray next to a view or cell left out; cells are kept where they are too many."""
        step = TAU / self._turn.views
        used = np.ones((self.gamma.size, self._turn.views), bool)
        for angles in self.views_of() if self._turn.filled_rad.size else ():
            for filled in self._turn.filled_rad:
                used &= np.abs(np.remainder(angles - filled + math.pi, TAU) - math.pi) > step
        touched = (np.abs(self.gamma[:, None] - np.abs(fan[self._turn.bridged])) < CELL_REACH * self._width).any(axis=1)
        if touched.mean() < MOST_TOUCHED:
            used[touched] = False
        touching = self._touching(fan)
        return used & ~touching if touching.mean() < MOST_TOUCHED else used

    def _touching(self, fan: FloatArray) -> NDArray[np.bool_]:
        """Select pairs (pairs, chi) with a ray at a sample that was left out."""
        if not self._turn.left_out.any():
            return np.zeros((self.gamma.size, self._turn.views), bool)
        reach = round(SAMPLE_REACH * self._width / float(np.median(np.diff(fan))))
        near = scipy.ndimage.binary_dilation(self._turn.left_out, np.ones((1, 2 * reach + 1), bool))
        rays = zip(self.views_of(), (self.gamma, -self.gamma), strict=True)
        here, there = (
            near[self._turn.nearest_view(angles), np.searchsorted(fan, gamma).clip(0, fan.size - 1)[:, None]]
            for angles, gamma in rays
        )
        return np.asarray(here | there)

    def at(self, vector: FloatArray) -> PairedRays:
        """Return the paired rays with this geometry."""
        rays, slopes = self._both_sides(vector)
        harmonics = np.empty((9, self.gamma.size, self._orders.size), np.complex128)
        np.subtract(rays[0], rays[1], out=harmonics[0])
        # A ray's derivative by gamma at fixed view is the one at fixed chi less the one by chi. The opposite ray has
        # the first with its sign reversed and the second as it is.
        np.add(slopes[0], slopes[1], out=harmonics[1])
        np.multiply(1j * self._orders, rays[0] + rays[1], out=harmonics[2])
        np.subtract(slopes[0], slopes[1], out=harmonics[3])
        np.multiply(1j * self._orders, harmonics[0], out=harmonics[4])
        np.multiply(0.5 * self._blur**2, harmonics[1:5], out=harmonics[5:9])
        harmonics[1:5] *= 0.5
        over_chi = self._over_chi(harmonics)
        over_chi[5:] *= self._used
        near, opposed = _shifts(vector, self.gamma), _shifts(vector, -self.gamma)
        return PairedRays(
            over_chi[0],
            Derivatives(over_chi[1:3], over_chi[5:7], over_chi[3:5], over_chi[7:9]),
            np.stack([near + opposed, opposed - near], axis=1),
            self._used,
        )

    def relative_residual(self, vector: FloatArray) -> float:
        """Return the RMS of the used pairs' blurred differences divided by the RMS of the blurred rays."""
        residual, signal = self._squares(vector)
        return math.sqrt(residual / signal)

    def unrest(self, vector: FloatArray, variance: FloatArray) -> float:
        """Return the variance of the used pairs' blurred differences, divided by the one that noise gives them.

        `vector` (3,): u_c in mm, tau in rad and SDD in mm. `variance` (detector,): variance of the rays' noise.
        """
        fan, covered = fan_angles(self.scanner, vector)
        # What blurs over cells and over harmonics other than the constant one leave of white noise.
        over_cells = np.median(covered) / (2.0 * math.sqrt(math.pi) * self._width)
        over_views = 2.0 * np.sum(self._blur[1:] ** 2) / self._turn.views
        of_pairs = sum(np.interp(gamma, fan, variance) for gamma in (self.gamma, -self.gamma))
        noise = over_cells * over_views * float(of_pairs @ self._used.sum(axis=1))
        return float(self._squares(vector)[0] / noise)

    def _squares(self, vector: FloatArray) -> FloatArray:
        """Return the sums of squares, (2,), of the used pairs' blurred differences and of their blurred rays."""
        (rays, opposite), _ = self._both_sides(vector)
        blurred = self._over_chi(self._blur * np.stack([rays - opposite, 0.5 * (rays + opposite)])) * self._used
        return np.asarray(np.sum(blurred**2, axis=(1, 2)))

    def _both_sides(self, vector: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return rays and opposite rays over chi, and both derivatives by the rays' gamma, (2, pairs, harmonics)."""
        fan, covered = fan_angles(self.scanner, vector)
        turned = _powers(np.exp(1j * fan), self._orders.size)
        turned *= covered[:, None]
        turned *= self._turn.spectrum
        rays, slopes = (each.view(np.complex128) for each in self._sides(turned.view(np.float64), fan))
        # The opposite ray is at -gamma, half a turn later.
        half_turn = np.where(self._orders % 2, -1.0, 1.0)
        rays[1] *= half_turn
        slopes[1] *= -half_turn
        return rays, slopes

    def mean_by_gamma(self, vector: FloatArray) -> FloatArray:
        """Return the derivative by gamma (pairs,) of half the sums of opposite rays of the views' mean.

        An unknown that is the same at every chi does not need this derivative; one that varies with chi does.
        """
        fan, covered = fan_angles(self.scanner, vector)
        _, slopes = self._sides((self._turn.mean * covered)[:, None], fan)
        return np.asarray(0.5 * (slopes[0] - slopes[1])[:, 0])

    def _over_chi(self, harmonics: ComplexArray) -> FloatArray:
        """Transform harmonics (..., orders) to (..., views) over chi."""
        return scipy.fft.irfft(harmonics, self._turn.views, overwrite_x=True)

    def _sides(self, turned: FloatArray, fan: FloatArray) -> FloatArray:
        """Interpolate values (cells, n), and derivatives by gamma, at the pairs' gamma and -gamma, (2, 2, pairs, n)."""
        gamma = np.concatenate([self.gamma, -self.gamma])[:, None]
        near = np.searchsorted(fan, gamma) + self._taps
        inside = (near >= 0) & (near < fan.size)
        near = near.clip(0, fan.size - 1)
        z = (gamma - fan[near]) / self._width
        kernel = np.exp(-0.5 * z * z) / (math.sqrt(TAU) * self._width) * inside
        borders = np.arange(2 * gamma.size + 1) * self._taps.size
        values, cells = np.concatenate([kernel, -z / self._width * kernel]), np.concatenate([near, near])
        weights = scipy.sparse.csr_array((values.ravel(), cells.ravel(), borders), shape=(2 * gamma.size, fan.size))
        return np.asarray(weights @ turned).reshape(2, 2, self.gamma.size, -1)

    def solve(
        self, start: FloatArray, low: FloatArray, high: FloatArray, *, free: slice, corrected: bool
    ) -> "Solution":
        """Iterate Gauss-Newton steps in the free unknowns from the start, inside the reach."""
        vector, settled = start, False
        for _ in range(STEPS):
            rays = self.at(vector)
            gram = rays.gram(corrected=corrected)[free, free]
            if not is_definite(gram):
                break
            covariance, before = rays.covariance(free, corrected=corrected), vector
            vector = vector.copy()
            vector[free] -= np.linalg.solve(gram, rays.scores.sum(axis=0)[free])
            vector = np.clip(vector, low, high)
            if np.all(np.abs(vector - before)[free] <= SMALL_STEP * np.sqrt(np.diag(covariance))):
                settled = bool(np.all((vector > low) & (vector < high)))
                if not np.isfinite(covariance).all():
                    rays = self.at(vector)
                    covariance = rays.covariance(free, corrected=corrected)
                return Solution(vector, settled, self, rays, covariance, free)
        return Solution(vector, settled, self, rays, np.full_like(gram, math.inf), free)


@dataclass(frozen=True, eq=False)
class Solution:
    """(u_c, tau, SDD) at the end of a fit, whether it came to rest inside the reach, and rays and covariance there."""

    vector: FloatArray
    settled: bool
    pairs: Pairs
    rays: PairedRays
    free_covariance: FloatArray
    free: slice

    @property
    def covariance(self) -> FloatArray:
        """Covariance of all three unknowns; those not free have zeros."""
        covariance = np.zeros((3, 3))
        covariance[self.free, self.free] = self.free_covariance
        return covariance

    def with_correlated(self, share: float) -> "Solution":
        """Return the solution with the covariance of differences that correlate over this share of the turn."""
        return replace(self, free_covariance=self.rays.covariance(self.free, corrected=True, correlated=share))

    def is_near(self, vector: FloatArray) -> bool:
        """Return whether another vector differs from this one by less than the errors can show."""
        return bool(np.all(np.abs(self.vector - vector)[self.free] <= NEAR * np.sqrt(np.diag(self.free_covariance))))

    @cached_property
    def relative_residual(self) -> float:
        """RMS of the blurred differences divided by the RMS of the blurred rays."""
        return self.pairs.relative_residual(self.vector)

    @cached_property
    def derivatives(self) -> Derivatives:
        """Derivatives of the pairs with the views' mean, for unknowns that vary with chi."""
        return self.rays.derivatives.with_mean(self.pairs.mean_by_gamma(self.vector), self.rays.used)

    @property
    def distance_sensitivity(self) -> FloatArray:
        """Change of (u_c, tau) per mm of the SDD at which they were fitted, (2,); zeros where SDD is free."""
        if self.free == ALL_THREE:
            return np.zeros(2)
        gram = self.rays.gram(corrected=True)
        return np.asarray(-np.linalg.solve(gram[:2, :2], gram[:2, 2]), np.float64)


def _shifts(vector: FloatArray, gamma: NDArray[np.floating]) -> FloatArray:
    """Return the angle that a ray at gamma turns per unit of (u_c, tau, SDD): du/dx over du/dgamma, (3, rays)."""
    _, tau, sdd = vector
    c = np.cos(gamma + tau)
    by = np.stack([np.ones_like(gamma), sdd * np.sin(gamma) * np.sin(gamma + tau) / c**2, np.sin(gamma) / c])
    return np.asarray(by * (c * c / (sdd * math.cos(tau))))


def _powers(base: ComplexArray, number: int) -> ComplexArray:
    """Return the powers of each base from 0 on, (bases, number)."""
    powers = np.ones((base.size, number), np.complex128)
    powers[:, 1], done = base, 2
    while done < number:
        more = min(done, number - done)
        np.multiply(powers[:, :more], powers[:, done // 2 : done // 2 + 1] ** 2, out=powers[:, done : done + more])
        done += more
    return powers
