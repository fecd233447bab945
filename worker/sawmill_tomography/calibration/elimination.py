"""Normal equations: terms that are linear are eliminated from them (variable projection), and their inverse.

Golub and Pereyra 2003; the derivative is Kaufman's. Gram matrices are those of `analytic.gram`.
"""

from collections.abc import Sequence

import numpy as np

from sawmill_tomography.calibration.fit_parameters import GramTerm
from sawmill_tomography.geometry.geometry import FloatArray

_LINEAR = [GramTerm.SHADOW, GramTerm.ONE]


def reduce(grams: FloatArray, kept: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of `kept` after gain and offset are projected out, and their coefficients, (2, kept).

    Raises
    ------
    numpy.linalg.LinAlgError
        If the linear terms do not stand apart: a phantom with no shadow on the detector.
    """
    gram = grams.sum(axis=0)
    linear, rest = gram[_LINEAR], gram[list(kept)]
    cross = rest[:, _LINEAR]
    solved = np.asarray(np.linalg.solve(linear[:, _LINEAR], cross.T), np.float64)
    return rest[:, kept] - cross @ solved, solved


def unit_scale(normal: FloatArray) -> FloatArray:
    """Return what makes the diagonal of a normal matrix one (n,): radians and millimetres differ by 1e4."""
    diagonal = np.diag(normal)
    scale: FloatArray = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    return scale


def scaled_inverse(normal: FloatArray, least: float = 1e-11) -> FloatArray:
    """Invert a normal matrix (n, n) of unit diagonal; what it does not determine has no variance."""
    scale = unit_scale(normal)
    both = np.outer(scale, scale)
    return pseudo_inverse(normal * both, least) * both


def pseudo_inverse(matrix: FloatArray, least: float) -> FloatArray:
    """Invert a symmetric matrix (n, n) but for eigenvalues below the share `least` of the largest."""
    values, vectors = np.linalg.eigh(matrix)
    size = np.abs(values)
    kept = size > least * size.max()
    inverse: FloatArray = vectors[:, kept] / values[kept] @ vectors[:, kept].T
    return inverse
