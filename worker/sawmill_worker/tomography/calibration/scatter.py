"""How far the residual is from white noise, and how much the parameters scatter for it."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sawmill_worker.tomography.calibration.covariance import Covariance
from sawmill_worker.tomography.calibration.elimination import project_out, seen_views
from sawmill_worker.tomography.calibration.errors import CalibrationError
from sawmill_worker.tomography.calibration.fit import Fit
from sawmill_worker.tomography.calibration.sinogram_data import SinogramData
from sawmill_worker.tomography.fit_parameters import MOMENTS, RAYS, GramTerm, Parameter
from sawmill_worker.tomography.geometry import FloatArray

# White noise scatters the estimate of the inflation itself; within this number of its standard deviations it is 1.
WHITE = 3.0
# What is wrong with a model turns with the phantom: it shows in the slowest harmonics of the views' scores, of
# which two are enough to measure it and few enough to lie close to the mean itself.
HARMONICS = 2
# Student's t at 97.5 % for the two or four degrees of freedom of one or two harmonics, against the normal 1.96.
STUDENT = (4.303 / 1.96, 2.776 / 1.96)
# An eigenvalue of the scaled normal equations below this is zero within rounding: the scan does not determine it.
SINGULAR = 1e-11
# An undetermined combination of parameters moves the rays when this much of it is R, SDD, u_c and tau.
RAYS_SHARE = 1e-3
RAY_PARAMETERS = list(Parameter)[RAYS]


@dataclass(frozen=True)
class Scatter:
    """How much the parameters scatter.

    Attributes
    ----------
    covariance : Covariance
        Of the seven unknowns, inflated by what the residual holds beside white noise.
    inflation : float
        Factor by which correlation within the views inflates it; 1 for white noise.
    deviation_ratio : float
        The standard deviations against those for white noise of the residual's RMS (RMS over the parameters).
    structured : bool
        Whether the residual is more than white noise.
    psi_identifiable : bool
        Whether the scan determines the first angle. That of a disc turns with its position.
    """

    covariance: Covariance
    inflation: float
    deviation_ratio: float
    structured: bool
    psi_identifiable: bool


@dataclass(frozen=True)
class _Scores:
    """Each view's derivative times residual (views, unknowns), by angle, where every unknown has the Gram matrix 1."""

    white: FloatArray
    unscale: FloatArray
    free: list[Parameter]
    psi_identifiable: bool


def parameter_scatter(grams: FloatArray, data: SinogramData, fit: Fit) -> Scatter:
    """The covariance that the residual warrants.

    Two things inflate it. Residuals that are correlated within a view: the views' scores are compared with what
    independent cells would give, the mean eigenvalue of the cluster-robust covariance against the classical one (Liang
    and Zeger 1986). And residuals that go on from view to view, as those of a wrong drawing, of blur or of a knot do:
    the power of the scores' slowest harmonics over the turn is added as the covariance of their mean (a long-run
    variance; Newey and West 1987 with the periodogram's lowest ordinates for a kernel).

    Parameters
    ----------
    grams : (views, 10 or 13, 10 or 13) float64
        `analytic.gram` at the fit.

    Raises
    ------
    CalibrationError
        If the views do not determine the geometry at all.
    """
    scores = _scores(grams, data, fit)
    views, unknowns = scores.white.shape
    noise = fit.residual_rms**2
    if noise <= 0.0:
        return Scatter(fit.covariance, 1.0, 1.0, structured=False, psi_identifiable=scores.psi_identifiable)
    inflation = 1.0
    if views > unknowns:
        clustered = float((scores.white**2).sum()) * views / (views - unknowns) / (unknowns * noise)
        inflation = clustered if clustered > 1.0 + WHITE * math.sqrt(2.0 / (views - unknowns)) else 1.0
    count = min(HARMONICS, (views - 1) // 2)
    waves = np.fft.rfft(scores.white, axis=0)[1 : count + 1]
    slow = float((np.abs(waves) ** 2).sum()) / (count * unknowns * noise)
    structured = inflation > 1.0 or slow > 1.0 + WHITE * math.sqrt(1.0 / (count * unknowns))
    values = fit.covariance.values * inflation
    if structured:
        back = (waves @ scores.unscale.T)[:, : len(scores.free)] * (STUDENT[count - 1] / fit.gain)
        values[np.ix_(scores.free, scores.free)] += np.real(back.conj().T @ back) / count
    ratio = np.diag(values)[scores.free] / np.diag(fit.covariance.values)[scores.free]
    covariance = replace(fit.covariance, values=values)
    return Scatter(covariance, inflation, math.sqrt(float(ratio.mean())), structured, scores.psi_identifiable)


def _scores(grams: FloatArray, data: SinogramData, fit: Fit) -> _Scores:
    free = fit.covariance.determined
    unknowns = [*free, GramTerm.SHADOW, GramTerm.ONE, *data.extras]
    coefficients: dict[int, float] = {
        GramTerm.SHADOW: -fit.gain,
        GramTerm.ONE: -fit.offset,
        GramTerm.SHADOW_SQUARED: -fit.gain * fit.hardening,
        GramTerm.DATA: 1.0,
    }
    coefficients |= {place: -fit.gain * slope for place, slope in zip(MOMENTS, fit.gradient_per_mm, strict=True)}
    if data.view_gain:
        unknowns = [*free, *data.extras]
        seen = seen_views(grams)
        kept = [*range(grams.shape[1])]
        grams, _ = project_out(grams[seen], [GramTerm.SHADOW, GramTerm.ONE], kept)
        angles = data.angles_rad[seen]
    else:
        angles = data.angles_rad
    weights = np.array([coefficients.get(place, 0.0) for place in range(grams.shape[1])])
    scores = (grams[:, unknowns, :] @ weights)[np.argsort(np.mod(angles, 2.0 * math.pi))]
    bread = grams.sum(axis=0)[np.ix_(unknowns, unknowns)]
    scale = 1.0 / np.sqrt(np.diag(bread))
    values, vectors = np.linalg.eigh(bread * np.outer(scale, scale))
    kept = values > SINGULAR * values[-1]
    undetermined = vectors[[place for place, p in enumerate(free) if p in RAY_PARAMETERS], :][:, ~kept]
    if (undetermined**2).sum() > RAYS_SHARE:
        raise CalibrationError(
            "too-few-views",
            f"the {len(scores)} views do not determine the geometry: other scanners would show the same; give more "
            "views, spread over the turn, or use a phantom with corners",
        )
    root = vectors[:, kept] / np.sqrt(values[kept])
    psi_identifiable = (
        Parameter.PSI in free and float((vectors[free.index(Parameter.PSI), ~kept] ** 2).sum()) <= RAYS_SHARE
    )
    return _Scores((scores * scale) @ root, scale[:, None] * root, free, psi_identifiable)
