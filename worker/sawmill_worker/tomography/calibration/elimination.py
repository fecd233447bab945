"""Variable projection on Gram matrices: terms that are linear are eliminated before the geometry is fitted.

Golub and Pereyra 2003; the derivative is Kaufman's. Gram matrices are those of `analytic.gram`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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


def seen_views(grams: FloatArray) -> NDArray[np.bool_]:
    """Which views (views,) show the phantom, so that each has a gain of its own, from Gram matrices of each."""
    shadow_power = grams[:, GramTerm.SHADOW, GramTerm.SHADOW]
    shown: NDArray[np.bool_] = shadow_power > 1e-9 * shadow_power.max()
    return shown


def reduce(
    grams: FloatArray, extras: Sequence[int], kept: Sequence[int], *, view_gain: bool
) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of `kept` after gain, offset and extras are projected out, and their coefficients for all views.

    With `view_gain` each view has a gain and an offset of its own; the coefficients are still the common ones.
    """
    total = grams.sum(axis=0)
    schur, coefficients = project_out(total, [GramTerm.SHADOW, GramTerm.ONE, *extras], kept)
    if not view_gain:
        return schur, coefficients
    both = [*kept, *extras]
    seen = seen_views(grams)
    used = grams[:, GramTerm.ONE, GramTerm.ONE] > 0.0
    per_view = project_out(grams[seen], [GramTerm.SHADOW, GramTerm.ONE], both)[0].sum(axis=0)
    per_view += project_out(grams[used & ~seen], [GramTerm.ONE], both)[0].sum(axis=0)
    count = len(kept)
    if extras:
        per_view, _ = project_out(per_view, list(range(count, len(both))), list(range(count)))
    return per_view, coefficients
