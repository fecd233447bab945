"""Normal equations: elimination of linear terms (variable projection), and inversion.

Golub and Pereyra 2003; the derivative is Kaufman's. The Gram matrices come from `analytic.gram`.
"""

from collections.abc import Sequence

import numpy as np

from sawmill_tomography.geometry.fit_parameters import GramTerm
from sawmill_tomography.geometry.geometry import FloatArray

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
    scale: FloatArray = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    return scale


def scaled_inverse(normal: FloatArray, least: float = 1e-11) -> FloatArray:
    """Invert a normal matrix (n, n), scaled to unit diagonal; undetermined directions have no variance."""
    scale = unit_scale(normal)
    both = np.outer(scale, scale)
    return pseudo_inverse(normal * both, least) * both


def pseudo_inverse(matrix: FloatArray, least: float) -> FloatArray:
    """Invert a symmetric matrix (n, n), leaving out eigenvalues below the share `least` of the largest."""
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    kept = size > least * size.max()
    inverse: FloatArray = vectors[:, kept] / values[kept] @ vectors[:, kept].T
    return inverse
