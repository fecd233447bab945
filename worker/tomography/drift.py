"""Drift without a phantom: over a full turn every ray is measured twice, once from either side.

p(phi, gamma) = p(phi + pi - 2 gamma, -gamma), gamma = atan2((u - u_c) cos tau, SDD + (u - u_c) sin tau): no R in it, so
u_c and tau (and weakly SDD) can be fitted to any dense full-turn scan (design page, section 5; the symmetry is that of
Kak and Slaney 1988, section 3.4.3). R and psi cannot be seen.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter
from scipy.optimize import least_squares

from worker.tomography.geometry import TAU, FloatArray, GeometryError, Scanner, SourceFrame, view_weights

# Between views farther apart than this the sinogram of a log cannot be interpolated to a tenth of its noise.
WIDEST_STEP_DEG = 3.0
# Parameters are scattered over blocks of views: neighbours share their interpolation errors.
BLOCKS = 24
# Standard deviation of the blur over (views, cells).
BLUR = (1.0, 1.5)


class DriftError(ValueError):
    """A scan that shows no drift; the message says why.

    Attributes
    ----------
    code : str
        Stable, for programs: sparse-views, partial-turn, nothing-seen.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class ConjugateFit:
    """What pairs of opposite rays say of the detector.

    Attributes
    ----------
    covariance : (3, 3) float64
        Of (u_c, tau, SDD).
    residual_rms : float
        Of the differences of paired rays, in the sinogram's unit.
    initial_rms : float
        The same with the geometry started from.
    """

    cor_column_mm: float
    tilt_rad: float
    source_to_detector_mm: float
    covariance: FloatArray
    residual_rms: float
    initial_rms: float

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of (u_c, tau, SDD)."""
        spread: FloatArray = np.sqrt(np.diag(self.covariance))
        return spread


class _Pairs:
    """Differences of paired rays, as a function of (u_c, tau, SDD)."""

    def __init__(self, scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray) -> None:
        self._scanner = scanner
        views = sinogram.shape[0]
        self._angles = np.arange(views) * TAU / views
        # Interpolating white noise weakens it between samples, and least squares would seek those places: blur first.
        self.sinogram = gaussian_filter(
            _equidistant(sinogram, angles_rad, self._angles), BLUR, mode=("grid-wrap", "nearest")
        )
        self._coefficients = spline_filter(self.sinogram, order=3, mode="grid-wrap")

    def differences(self, vector: FloatArray) -> FloatArray:
        """Each ray less its partner from the other side, (views, cells); 0 where the partner misses the detector."""
        u_c, tau, sdd = vector
        w = self._scanner.cell_centres_mm - u_c
        gamma = np.arctan2(w * math.cos(tau), sdd + w * math.sin(tau))
        # The partner has -gamma: w' = SDD sin(-gamma) / cos(-gamma + tau).
        partner = u_c - sdd * np.sin(gamma) / np.cos(tau - gamma)
        cell = partner / self._scanner.detector_pitch_mm + 0.5 * self._scanner.num_detector_pixels - 0.5
        view = (self._angles[:, None] + math.pi - 2.0 * gamma[None, :]) * (len(self._angles) / TAU)
        seen = (cell >= 0.0) & (cell <= self._scanner.num_detector_pixels - 1.0)
        where = np.stack([view, np.broadcast_to(cell, view.shape)])
        other = map_coordinates(self._coefficients, where, order=3, mode="grid-wrap", prefilter=False)
        return np.where(seen[None, :], self.sinogram - other, 0.0)


def _equidistant(sinogram: FloatArray, angles_rad: FloatArray, wanted: FloatArray) -> FloatArray:
    """The sinogram at equidistant angles from 0, by periodic cubic splines over the views."""
    wrapped = np.mod(angles_rad, TAU)
    order = np.argsort(wrapped, kind="stable")
    knots = np.append(wrapped[order], wrapped[order[0]] + TAU)
    values = np.concatenate([sinogram[order], sinogram[order[:1]]])
    moved = np.mod(wanted - knots[0], TAU) + knots[0]
    resampled: FloatArray = CubicSpline(knots, values, bc_type="periodic")(moved)
    return resampled


def conjugate_fit(scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame) -> ConjugateFit:
    """Fit u_c, tau and SDD to the pairs of opposite rays of any object.

    Parameters
    ----------
    sinogram : (views, detector) float
        Line integrals of anything that stayed still on the turntable, all round.
    angles_rad : (views,) float64
        As the scanner's sense of rotation reads them.
    start : SourceFrame
        The calibrated geometry.

    Raises
    ------
    DriftError
        If the views are sparse or do not go all round, or the scan is empty.
    """
    _check(sinogram, angles_rad)
    pairs = _Pairs(scanner, np.asarray(sinogram, np.float64), np.asarray(angles_rad, np.float64))
    first = np.array([start.cor_column_mm, start.tilt_rad, start.source_to_detector_mm])
    scale = np.array([1.0, 0.01, 20.0])

    def residual(x: FloatArray) -> FloatArray:
        return pairs.differences(first + x * scale).ravel()

    before = residual(np.zeros(3))
    solved = least_squares(residual, np.zeros(3), method="lm", diff_step=[1e-4] * 3)
    if not solved.success:
        raise DriftError(
            "nothing-seen", f"the paired rays do not agree for any geometry near the start: {solved.message}"
        )
    u_c, tau, sdd = first + solved.x * scale
    covariance = _covariance(np.asarray(solved.jac, np.float64), solved.fun, len(sinogram)) * np.outer(scale, scale)
    return ConjugateFit(
        cor_column_mm=float(u_c),
        tilt_rad=float(tau),
        source_to_detector_mm=float(sdd),
        covariance=covariance,
        residual_rms=float(np.sqrt(np.mean(solved.fun**2))),
        initial_rms=float(np.sqrt(np.mean(before**2))),
    )


def _check(sinogram: FloatArray, angles_rad: FloatArray) -> None:
    try:
        view_weights(angles_rad)
    except GeometryError as error:
        raise DriftError("partial-turn", str(error)) from error
    gaps = np.diff(np.sort(np.mod(angles_rad, TAU)))
    widest = math.degrees(float(gaps.max()))
    if widest > WIDEST_STEP_DEG:
        raise DriftError(
            "sparse-views",
            f"{angles_rad.size} views stand up to {widest:.3g} degrees apart: opposite rays can be paired only where "
            f"views are at most {WIDEST_STEP_DEG:g} degrees apart; calibrate with the phantom instead",
        )
    if np.ptp(sinogram) == 0.0:
        raise DriftError("nothing-seen", "every value of the sinogram is the same: nothing was scanned")


def _covariance(jacobian: FloatArray, residual: FloatArray, views: int) -> FloatArray:
    """Cluster-robust covariance, blocks of neighbouring views as clusters; every pair stands in it twice."""
    bread = np.linalg.inv(jacobian.T @ jacobian)
    scores = (jacobian * residual[:, None]).reshape(views, -1, jacobian.shape[1]).sum(axis=1)
    blocks = np.add.reduceat(scores, np.arange(BLOCKS) * views // BLOCKS, axis=0)
    meat = blocks.T @ blocks * BLOCKS / (BLOCKS - 1)
    # A pair's two differences are one measurement: its scores lie in two blocks, so half of the variance is hidden.
    return 2.0 * bread @ meat @ bread
