"""Variable projection on Gram matrices: terms that are linear are eliminated before the geometry is fitted.

Golub and Pereyra 2003; the derivative is Kaufman's. Gram matrices are those of `analytic.gram`.
"""

from collections.abc import Sequence

import numpy as np

from sawmill_worker.tomography.fit_parameters import GramTerm
from sawmill_worker.tomography.geometry import FloatArray


def project_out(gram: FloatArray, linear: Sequence[int], kept: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Gram matrix (or stack of them) of `kept` less their projections on `linear`, and those projections' coefficients.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the linear terms do not stand apart: a phantom with no shadow on the detector.
    """
    cross = gram[..., kept, :][..., linear]
    solved = np.asarray(np.linalg.solve(gram[..., linear, :][..., linear], np.swapaxes(cross, -1, -2)), np.float64)
    return gram[..., kept, :][..., kept] - cross @ solved, solved


def reduce(grams: FloatArray, kept: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of `kept` after gain and offset are projected out, and their coefficients, (2, kept)."""
    return project_out(grams.sum(axis=0), [GramTerm.SHADOW, GramTerm.ONE], kept)
