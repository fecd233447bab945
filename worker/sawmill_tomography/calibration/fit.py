"""Least squares on the sinogram: Levenberg-Marquardt with gain and background eliminated.

min over (psi, R, SDD, u_c, tau, t_x, t_y) of || g * proj(phantom at t) + b - y ||^2, g and b in closed form (variable
projection with Kaufman's derivative; Golub and Pereyra 2003). All inner products come from the per-view Gram matrices
of `analytic.gram`, so no derivative is ever stored.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.covariance import Covariance, reduce, scaled_inverse
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.fit_parameters import RAYS, FitParameter, GramTerm
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, SourceFrame, to_vector, wrap_angle
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import project


@dataclass(frozen=True)
class FittedModel:
    """A geometry with the gain and offset that explain most of the scan."""

    frame: SourceFrame
    position_mm: tuple[float, float]  # the phantom's position, x and y
    gain: float
    offset: float
    residual_rms: float
    relative_residual: float

    def to_vector(self) -> FloatArray:
        """Return the seven unknowns, (7,), in the order of `FitParameter`."""
        return np.concatenate([to_vector(self.frame), self.position_mm])

    def prediction(self, phantom: Phantom, data: SinogramData) -> FloatArray:
        """Compute the sinogram (views, cells) that the phantom has at the angles of the data."""
        cells, rays, at = data.cells, data.rays_per_cell, self.position_mm
        lengths = project(phantom, cells, self.frame, data.angles_rad, position_mm=at, rays_per_cell=rays)
        return self.gain * lengths + self.offset


@dataclass(frozen=True)
class Fit(FittedModel):
    """The end point of least squares."""

    covariance: Covariance  # covariance of the seven unknowns for white noise of the residual's size
    converged: bool
    iterations: int


# A fit ends where a step would gain less than this share of one sample's variance (a tenth of a standard deviation).
NO_GAIN = 0.01
# A step is slow when it lowers the sum of squares by less than this share.
SLOW = 0.2

# Called at each step of a fit; the number of steps is not known beforehand.
OnStep = Callable[[], None]


def ignore_progress() -> None:
    """Ignore the steps of a fit."""


@dataclass(frozen=True)
class _Normal:
    """The normal equations after gain and offset are eliminated."""

    rss: float
    gain: float
    offset: float
    hessian: FloatArray
    gradient: FloatArray


def _eliminate(grams: FloatArray) -> _Normal | None:
    """Project the linear terms out of derivatives and data; None where the model shows nothing."""
    try:
        schur, solved = reduce(grams, [*FitParameter, GramTerm.DATA])
    except np.linalg.LinAlgError:  # the model is zero, or the same everywhere
        return None
    gain, offset = solved[:, -1].tolist()
    if not (np.isfinite(schur).all() and gain > 0.0):
        return None
    return _Normal(
        rss=max(float(schur[-1, -1]), 0.0),
        gain=gain,
        offset=offset,
        hessian=gain * gain * schur[:-1, :-1],
        gradient=gain * schur[:-1, -1],
    )


def _normal_equations(phantom: Phantom, data: SinogramData, x: FloatArray) -> _Normal | None:
    """Compute the normal equations at x (7,), in the order of `FitParameter`; None without geometry or shadow."""
    if not np.isfinite(x).all() or abs(x[FitParameter.TILT]) > 1.4 or not 0.0 < x[FitParameter.R] < x[FitParameter.SDD]:
        return None
    try:
        return _eliminate(data.gram(phantom, x))
    except GeometryError:  # the phantom would reach the source
        return None


def refine(
    phantom: Phantom,
    data: SinogramData,
    start: SourceFrame,
    *,
    position_mm: tuple[float, float] = (0.0, 0.0),
    fixed_source_distance: bool = False,
    max_iterations: int = 60,
    hopeless: float = math.inf,
    on_step: OnStep = ignore_progress,
) -> Fit | None:
    """Go from an initial guess in the right basin to the basin's minimum.

    None where the guess explains nothing: the phantom has no shadow on the detector, or the gain is not positive.
    """
    centre = float(np.average(data.sinogram, weights=data.weights))
    centred = replace(data, sinogram=data.sinogram - centre)
    held = frozenset({FitParameter.R}) if fixed_source_distance else frozenset[FitParameter]()
    free = np.array([p for p in FitParameter if p not in held])
    x = np.concatenate([to_vector(start), position_mm])
    current = _normal_equations(phantom, centred, x)
    if current is None:
        return None
    weighted = centred.sinogram if data.weights is None else data.weights * centred.sinogram
    samples, power, identity = data.samples, float(np.vdot(weighted, centred.sinogram)), np.eye(free.size)
    # Rounding of a sum of squares (Higham and Mary 2019, SIAM Journal on Scientific Computing 41, A2815).
    least = np.finfo(np.float64).eps * math.sqrt(samples) * power
    damping, converged, iterations = 1e-3, False, 0
    while iterations < max_iterations:
        iterations += 1
        on_step()
        hessian, gradient = current.hessian[free][:, free], current.gradient[free]
        try:
            step = np.linalg.solve(hessian * (1.0 + damping * identity), gradient)
        except np.linalg.LinAlgError:  # a direction the data do not see at all: damp harder
            step = np.full(free.size, np.nan)
        if damping < 1.0 and float(step @ gradient) <= NO_GAIN / samples * max(current.rss, least):
            converged = True
            break
        trial = x.copy()
        trial[free] += step
        then = _normal_equations(phantom, centred, trial)
        if then is not None and then.rss <= current.rss:
            slow = then.rss > (1.0 - SLOW) * current.rss
            x, current, damping = trial, then, max(damping * 0.1, 1e-12)
            if slow and current.rss > hopeless**2 * power:
                break
        else:
            damping = max(damping * 10.0, 1e-9)
            if damping > 1e8:
                converged = then is not None and abs(then.rss - current.rss) <= 1e-9 * current.rss
                break
    return _fit(centred, x, current, held, centre, power / samples, converged=converged, iterations=iterations)


def _fit(
    data: SinogramData,
    x: FloatArray,
    normal: _Normal,
    held: frozenset[FitParameter],
    centre: float,
    mean_square: float,
    *,
    converged: bool,
    iterations: int,
) -> Fit:
    count = data.samples
    determinable = [p for p in FitParameter if p not in held]
    free = np.array(determinable)
    covariance = np.zeros((len(FitParameter), len(FitParameter)))
    inverse = scaled_inverse(normal.hessian[np.ix_(free, free)], least=1e-15)
    covariance[np.ix_(free, free)] = inverse * normal.rss / max(count - free.size - 2, 1.0)
    residual_rms = math.sqrt(normal.rss / count)
    return Fit(
        frame=SourceFrame.from_vector((wrap_angle(x[FitParameter.PSI]), *x[RAYS])),
        position_mm=(float(x[FitParameter.T_X]), float(x[FitParameter.T_Y])),
        gain=normal.gain,
        offset=normal.offset + centre,
        covariance=Covariance(covariance, held, frozenset(p for p in determinable if not covariance[p, p] > 0.0)),
        residual_rms=residual_rms,
        relative_residual=residual_rms / math.sqrt(mean_square) if mean_square > 0.0 else math.inf,
        converged=converged,
        iterations=iterations,
    )
