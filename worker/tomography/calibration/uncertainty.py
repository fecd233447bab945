"""How far the residual is from white noise, and what that does to the error bars."""

import math

import numpy as np

from worker.tomography.calibration.refine import DATA, MODEL, MOMENTS, ONE, SQUARE, Fit, SinogramData, project_out
from worker.tomography.geometry import FloatArray
from worker.tomography.phantom import Phantom

# White noise scatters the estimate of the inflation itself; within so many of its standard deviations it is 1.
WHITE = 3.0


def residual_inflation(phantom: Phantom, data: SinogramData, fit: Fit) -> float:
    """How much wider the parameters scatter than white noise of the same RMS would make them; 1 for white noise.

    The views' scores (derivative times residual) are compared with what independent cells would give: the mean
    eigenvalue of the cluster-robust covariance against the classical one (Liang and Zeger 1986), views as clusters.
    """
    free = [i for i in range(7) if fit.covariance[i, i] > 0.0]
    grams = data.gram(phantom, fit.to_vector(), fit.hardening)
    scores, bread = _scores(grams, data, fit, free)
    views, unknowns = scores.shape
    noise = fit.residual_rms**2
    if views <= unknowns or noise <= 0.0:
        return 1.0
    scale = 1.0 / np.sqrt(np.diag(bread))
    inverse = np.linalg.pinv(bread * np.outer(scale, scale), hermitian=True)
    meat = (scores * scale).T @ (scores * scale) * views / (views - unknowns)
    inflation = float(np.trace(inverse @ meat)) / (unknowns * noise)
    return inflation if inflation > 1.0 + WHITE * math.sqrt(2.0 / (views - unknowns)) else 1.0


def _scores(grams: FloatArray, data: SinogramData, fit: Fit, free: list[int]) -> tuple[FloatArray, FloatArray]:
    """Each view's derivative times residual, (views, unknowns), and the unknowns' Gram matrix."""
    unknowns = [*free, MODEL, ONE, *data.extras]
    coefficients = {MODEL: -fit.gain, ONE: -fit.offset, SQUARE: -fit.gain * fit.hardening, DATA: 1.0}
    coefficients |= {place: -fit.gain * slope for place, slope in zip(MOMENTS, fit.gradient_per_mm, strict=True)}
    if data.view_gain:
        unknowns = [*free, *data.extras]
        seen = grams[:, MODEL, MODEL] > 1e-9 * grams[:, MODEL, MODEL].max()
        kept = [*range(grams.shape[1])]
        projected, _ = project_out(grams[seen], [MODEL, ONE], kept)
        grams = projected
    weights = np.array([coefficients.get(place, 0.0) for place in range(grams.shape[1])])
    return grams[:, unknowns, :] @ weights, grams.sum(axis=0)[np.ix_(unknowns, unknowns)]
