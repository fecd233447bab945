"""How much the wood's density varies from patch to patch: a random effect, whose variance the scan shows."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray

# Standard deviations that are compared, as a share of the wood's density.
DEVIATIONS = np.geomspace(1e-3, 0.2, 60)
# Eigenvalues below this share of the largest are combinations of patches that the scan does not show.
SINGULAR = 1e-9


@dataclass(frozen=True)
class Variation:
    """How much the wood's density varies from patch to patch."""

    deviation: float  # standard deviation, as a share of the wood's density
    likelihood: float  # twice the logarithm of the likelihood ratio against wood of one density


def variation(normal: FloatArray, score: FloatArray, noise: float) -> Variation:
    """Estimate the variation by the largest restricted likelihood (Patterson and Thompson 1971).

    `normal` (patches, patches), `score` (patches,): normal equations of the densities, from densities of 0, next to the
    columns of the fit.
    """
    if noise <= 0.0:
        return Variation(float(DEVIATIONS[0]), 0.0)
    values, vectors = np.linalg.eigh(normal)
    kept = values > SINGULAR * values[-1]
    values, seen = values[kept], vectors[:, kept].T @ score
    expected = noise * values + np.concatenate([[0.0], DEVIATIONS])[:, None] ** 2 * values**2
    uniform, *misfits = (np.log(expected) + seen**2 / expected).sum(axis=1).tolist()
    best = int(np.argmin(misfits))
    return Variation(float(DEVIATIONS[best]), uniform - misfits[best])
