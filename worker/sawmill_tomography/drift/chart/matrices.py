"""Symmetric 2 x 2 matrices over any leading axes: faster in closed form than one LAPACK call per matrix."""

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray


def inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverses (..., 2, 2) of positive definite matrices; zeros for singular matrices."""
    first, cross, second = matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]
    determinant = first * second - cross**2
    # A determinant below the rounding error of its two terms is zero.
    regular = determinant > 4.0 * np.finfo(float).eps * np.abs(first * second)
    over = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=regular)
    inverted = np.stack([second, -cross, -cross, first], axis=-1) * over[..., None]
    return inverted.reshape(matrices.shape)


def times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the products (..., 2) of matrices (..., 2, 2) and vectors (..., 2)."""
    first, second = vectors[..., 0], vectors[..., 1]
    return np.stack([row[..., 0] * first + row[..., 1] * second for row in np.moveaxis(matrices, -2, 0)], axis=-1)


def squared_length(vectors: FloatArray, precision: FloatArray) -> FloatArray:
    """Return x^T P x (...), for vectors (..., 2), matrices (..., 2, 2): chi-squared if P is the inverse covariance."""
    first, second = vectors[..., 0], vectors[..., 1]
    length: FloatArray = (
        precision[..., 0, 0] * first**2 + 2.0 * precision[..., 0, 1] * first * second + precision[..., 1, 1] * second**2
    )
    return length


def sandwich(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Return A B A, (..., 2, 2)."""
    columns = (times(outer, times(inner, outer[..., :, k])) for k in range(2))
    return np.stack(list(columns), axis=-1)


def whitened(vectors: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return L^-1 x, (..., 2), with L the lower Cholesky factor of the covariance (..., 2, 2)."""
    first, cross, second = _cholesky(covariance)
    along = vectors[..., 0] / first
    return np.stack([along, (vectors[..., 1] - cross * along) / second], axis=-1)


def scaled(covariance: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return L M L^T, (..., 2, 2), with L the lower Cholesky factor of the covariance and M the ratio (..., 2, 2)."""
    first, cross, second = _cholesky(covariance)
    upper, mixed, lower = ratio[..., 0, 0], ratio[..., 0, 1], ratio[..., 1, 1]
    off = first * (upper * cross + mixed * second)
    last = upper * cross**2 + 2.0 * mixed * cross * second + lower * second**2
    return np.stack([first**2 * upper, off, off, last], axis=-1).reshape(covariance.shape)


def _cholesky(covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the factor's upper left, lower left and lower right elements, (...) each; zeros for a zero matrix."""
    first = np.sqrt(covariance[..., 0, 0])
    cross = np.divide(covariance[..., 1, 0], first, out=np.zeros_like(first), where=first > 0.0)
    return first, cross, np.sqrt(np.maximum(covariance[..., 1, 1] - cross**2, 0.0))
