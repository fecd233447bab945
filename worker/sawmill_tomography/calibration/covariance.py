"""Normal equations: elimination of linear terms, inversion, and a covariance with parameters held exactly or unknown.

Elimination is variable projection (Golub and Pereyra 2003; the derivative is Kaufman's), with Gram matrices of
`analytic.gram`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter, GramTerm
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, to_vector
from sawmill_tomography.statistics import TWO_SIDED_95

# Chance explains what is off by up to this number of standard deviations: one sample of 16 000 is further off.
CHANCE = 4.0


@dataclass(frozen=True, eq=False)
class Covariance:
    """Covariance of the fit's parameters, in the order of `FitParameter`."""

    values: FloatArray  # (n, n): covariance of the first n parameters
    held: frozenset[FitParameter] = field(default=frozenset())
    unknown: frozenset[FitParameter] = field(default=frozenset())  # parameters that the scan does not determine

    @property
    def determined(self) -> list[FitParameter]:
        """Parameters that have a variance, in order."""
        return [p for p in FitParameter if p < len(self.values) and p not in self.held | self.unknown]

    @property
    def of_frame(self) -> "Covariance":
        """Covariance of the geometry's five parameters alone; a copy."""
        return replace(self, values=self.values[FRAME, FRAME].copy())


def frame_deviation(frame: SourceFrame, covariance: FloatArray) -> FloatArray:
    """Compute standard deviations (6,) of (psi, R, SDD, u_c, tau, M) from the covariance (5, 5) of the first five."""
    r, sdd = frame.source_distance_mm, frame.source_to_detector_mm
    slope = np.array([0.0, -sdd / (r * r), 1.0 / r, 0.0, 0.0])
    return np.append(np.sqrt(np.diag(covariance)), math.sqrt(max(float(slope @ covariance @ slope), 0.0)))


def theta_covariance(scanner: Scanner, frame: SourceFrame, theta: Theta, covariance: FloatArray) -> FloatArray | None:
    """Propagate the covariance to theta to first order, (5, 5); None where h_S is not resolved from zero."""
    r, r_s = frame.source_distance_mm, scanner.source_to_cor_mm
    spread = math.sqrt(float(covariance[FitParameter.R, FitParameter.R]))
    if spread == 0.0 or r - r_s <= TWO_SIDED_95 * spread:
        return None
    sign = 1 if theta.source_shift_mm >= 0.0 else -1
    vector = to_vector(frame)
    # A step in R must stay well above r_S, where h_S has a square-root branch point.
    columns = []
    for index, step in enumerate(np.array([1e-6, min(1e-4, 1e-3 * (r - r_s)), 1e-3, 1e-3, 1e-6])):
        ends = []
        for direction in (1.0, -1.0):
            moved = vector.copy()
            moved[index] += direction * step
            ends.append(to_vector(SourceFrame.from_vector(moved).theta(r_s, source_shift_sign=sign)))
        change = ends[0] - ends[1]
        change[0] = math.remainder(change[0], 2.0 * math.pi)
        columns.append(change / (2.0 * step))
    slope = np.stack(columns, -1)
    return np.asarray(slope @ covariance @ slope.T)


_LINEAR = [GramTerm.SHADOW, GramTerm.ONE]


def reduce(grams: FloatArray, kept: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Project gain and offset out; return the Gram matrix of `kept` and the coefficients of both, (2, kept)."""
    gram = grams.sum(axis=0)
    linear, rest = gram[_LINEAR], gram[list(kept)]
    cross = rest[:, _LINEAR]
    solved = np.asarray(np.linalg.solve(linear[:, _LINEAR], cross.T), np.float64)
    return rest[:, kept] - cross @ solved, solved


def unit_scale(normal: FloatArray) -> FloatArray:
    """Return the scale (n,) that makes the diagonal of a normal matrix one: radians and millimetres differ by 1e4."""
    diagonal = np.diag(normal)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, np.inf)))


def scaled_inverse(normal: FloatArray, least: float = 1e-11) -> FloatArray:
    """Invert a normal matrix (n, n), scaled to unit diagonal; undetermined directions have no variance."""
    scale = unit_scale(normal)
    both = scale[:, None] * scale
    return pseudo_inverse(normal * both, least) * both


def pseudo_inverse(matrix: FloatArray, least: float) -> FloatArray:
    """Invert a symmetric matrix (n, n), leaving out eigenvalues below the share `least` of the largest.

    No eigenvalue of a positive matrix is below the reciprocal of its inverse's trace, nor above its own trace: where
    these are near enough to each other, none is left out, and the inverse is Cholesky's.
    """
    root, failed = dpotrf(matrix, lower=1)
    if not failed and len(matrix):
        inverse, failed = dpotri(root, lower=1)
        if not failed and least * matrix.trace() * inverse.trace() < 1.0:
            inverse += inverse.T  # above its diagonal were zeros
            inverse.flat[:: len(inverse) + 1] *= 0.5
            return np.asarray(inverse)
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    kept = size > least * size.max()
    return np.asarray(vectors[:, kept] / values[kept] @ vectors[:, kept].T)
