"""Variable projection on Gram matrices: terms that are linear are eliminated before the geometry is fitted.

Golub and Pereyra 2003; the derivative is Kaufman's. Gram matrices are those of `analytic.gram`.
"""

from collections.abc import Sequence

import numpy as np

from sawmill_worker.tomography.fit_parameters import GramTerm
from sawmill_worker.tomography.geometry import FloatArray

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
