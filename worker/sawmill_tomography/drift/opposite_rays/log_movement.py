"""Detection of a log that moved while it was scanned, from its pairs of opposite rays.

A log that shifts by t between two views shifts the rays after it by -(dP/ds) t . n(chi), s the distance of a ray from
the COR and n its normal; a pair of rays shows this only where one was measured before and the other after. Each view
is tried as the first after the shift (docs/understand/verdict.md#a-second-witness).
"""

import math

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.change import LogMovement
from sawmill_tomography.drift.opposite_rays.opposite_rays import Solution
from sawmill_tomography.geometry.geometry import TAU, FloatArray

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
    chi_squared = float(shift @ np.linalg.solve(covariance, shift))
    return LogMovement(int(tried[best]), math.hypot(*shift), chi_squared)


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
        covariance: FloatArray = bread @ (scores.T @ scores) @ bread.T
        return covariance

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
    at = np.searchsorted(middles, np.mod(angles - turn[0], TAU) + turn[0]) % turn.size
    taken: NDArray[np.intp] = order[at]
    return taken
