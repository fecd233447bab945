"""The expected precision of a phantom before the phantom is made: the Cramér-Rao bound of the fit to the sinogram."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.covariance import frame_deviation, reduce, theta_covariance
from sawmill_tomography.calibration.refusals import refuse_round
from sawmill_tomography.calibration.scale import ScaleUncertainty, scale_uncertainty
from sawmill_tomography.calibration.sinogram_data import counted_radius_mm, refuse_log_beyond_source
from sawmill_tomography.geometry.fit_parameters import GramTerm
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError
from sawmill_tomography.geometry.ray_error import RayErrorPrediction, predicted_ray_error
from sawmill_tomography.phantoms.phantom import Phantom, PhantomError
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import PARAMETERS, DetectorCells

NAMES = ("psi", "R", "SDD", "u_c", "tau", "position x", "position y")


@dataclass(frozen=True)
class CramerRaoPlan:
    """The precision to expect of a calibration with one scan of a phantom."""

    noise: float  # standard deviation of the noise, in the unit of the phantom's line integrals (mm times density)
    covariance: FloatArray  # (5, 5)
    frame_deviation: FloatArray  # (6,): standard deviations of (psi, R, SDD, u_c, tau, M)
    theta_deviation: FloatArray | None  # (5,) or None: standard deviations of theta
    radius_mm: float  # radius of the disc in which ray errors are counted
    predicted_ray_error: RayErrorPrediction  # predicted ray error from noise alone
    scale: ScaleUncertainty
    views_cut_off: int  # views whose shadow reaches an end of the detector


def plan(
    geometry: FanBeamGeometry, phantom: Phantom, *, noise: float, log_radius_mm: float | None = None
) -> CramerRaoPlan:
    """Compute the precision to expect of this phantom, placed on the rotation centre, at these views.

    Parameters
    ----------
    geometry : FanBeamGeometry
        The scanner with its nominal theta, and the views.
    noise : float
        Standard deviation of the noise against the RMS of the phantom's sinogram: 0.02 is 2 %.
    log_radius_mm : float or None
        Radius of the disc in which ray errors are counted; None takes the phantom's.

    Raises
    ------
    PhantomError
        If the scan leaves a parameter undetermined: the phantom is too symmetric, or casts no shadow.
    GeometryError
        If the phantom reaches the source, the disc of the log's radius contains the source, or the noise is not
        positive.
    """
    if not (math.isfinite(noise) and noise > 0.0):
        raise GeometryError(f"noise must be a positive fraction of the sinogram's RMS, as 0.02, not {noise}")
    refuse_round(phantom)
    scanner, frame = geometry.scanner, geometry.frame
    refuse_log_beyond_source(log_radius_mm, scanner)
    cells = DetectorCells.of(scanner)
    sinogram = analytic.project(phantom, cells, frame, geometry.angles_rad)
    sigma = noise * float(np.sqrt(np.mean(sinogram * sinogram)))
    if sigma == 0.0:
        raise PhantomError(f"the phantom {phantom.name!r} casts no shadow on the detector of this geometry")
    grams = analytic.gram(phantom, cells, frame, geometry.angles_rad, sinogram)
    covariance = sigma * sigma * _inverse(phantom, grams)[:5, :5]
    radius_mm = counted_radius_mm(log_radius_mm, phantom)
    of_theta = theta_covariance(scanner, frame, geometry.theta, covariance)
    return CramerRaoPlan(
        noise=sigma,
        covariance=covariance,
        frame_deviation=frame_deviation(frame, covariance),
        theta_deviation=None if of_theta is None else np.sqrt(np.diag(of_theta)),
        radius_mm=radius_mm,
        predicted_ray_error=predicted_ray_error(scanner, frame, covariance, radius_mm=radius_mm),
        scale=scale_uncertainty(scanner, frame, phantom, covariance, radius_mm),
        views_cut_off=int(np.count_nonzero(np.any(sinogram[:, [0, -1]] != 0.0, axis=1))),
    )


def _inverse(phantom: Phantom, grams: FloatArray) -> FloatArray:
    """Compute the inverse information of unit noise, (7, 7), with gain and background projected out."""
    information, _ = reduce(grams, list(range(PARAMETERS)))
    size = np.diag(grams.sum(axis=0))[:PARAMETERS]
    # Radians and millimetres differ by 1e4: the diagonal is scaled to one before inverting.
    scale = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    # Each element is a sum over the samples, which rounding changes by up to eps for each of them.
    if values[0] < np.finfo(np.float64).eps * grams[:, GramTerm.ONE, GramTerm.ONE].sum() * values[-1]:
        names = " and ".join(name for name, share in zip(NAMES, np.abs(vectors[:, 0]), strict=True) if share > 0.1)
        raise PhantomError(
            f"a scan of the phantom {phantom.name!r} leaves {names} undetermined: choose a body with less symmetry, or "
            "more views of it"
        )
    return np.asarray((vectors / values) @ vectors.T * np.outer(scale, scale))
