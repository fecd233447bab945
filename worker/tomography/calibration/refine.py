"""Least squares on the sinogram: Levenberg-Marquardt with gain and background eliminated.

min over (psi, R, SDD, u_c, tau, t_x, t_y) of || g * proj(phantom at t) + b - y ||^2, g and b in closed form (variable
projection with Kaufman's derivative; Golub and Pereyra 2003). Every inner product that this needs comes from the
per-view Gram matrices of `analytic.gram`, so no derivative is ever stored.
"""

import math
from dataclasses import dataclass

import numpy as np

from worker.tomography import analytic
from worker.tomography.analytic import PARAMETERS, DetectorCells
from worker.tomography.geometry import FloatArray, SourceFrame
from worker.tomography.phantom import Phantom

R_INDEX = 1
MODEL, ONE, DATA = PARAMETERS, PARAMETERS + 1, PARAMETERS + 2


@dataclass(frozen=True)
class SinogramData:
    """What the model is compared with.

    Attributes
    ----------
    sinogram : (views, cells) float64
        Line integrals.
    angles_rad : (views,) float64
        As one sense of rotation reads them.
    cells : DetectorCells
        Where the cells lie.
    rays_per_cell : int or None
        Rays a cell in the model; None averages over the cell.
    """

    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    rays_per_cell: int | None = None


@dataclass(frozen=True)
class Fit:
    """Where least squares ended.

    Attributes
    ----------
    covariance : (7, 7) float64
        Of (psi, R, SDD, u_c, tau, t_x, t_y) for the noise that the residual shows; rows of fixed parameters are zero.
    residual_rms, relative_residual : float
        In the sinogram's unit, and against the RMS of the sinogram without its mean.
    """

    frame: SourceFrame
    position_mm: tuple[float, float]
    gain: float
    offset: float
    covariance: FloatArray
    residual_rms: float
    relative_residual: float
    converged: bool
    iterations: int


@dataclass(frozen=True)
class _Normal:
    """The normal equations after gain and offset are eliminated."""

    rss: float
    gain: float
    offset: float
    hessian: FloatArray
    gradient: FloatArray


def _eliminate(gram: FloatArray) -> _Normal | None:
    """Project projection and constant out of derivatives and data; None where the model shows nothing."""
    linear = np.ix_([MODEL, ONE], [MODEL, ONE])
    kept = [*range(PARAMETERS), DATA]
    cross = gram[np.ix_(kept, [MODEL, ONE])]
    try:
        solved = np.linalg.solve(gram[linear], cross.T)
    except np.linalg.LinAlgError:  # a phantom with no shadow on the detector: a model of zeros
        return None
    schur = gram[np.ix_(kept, kept)] - cross @ solved
    gain, offset = float(solved[0, -1]), float(solved[1, -1])
    if not (np.isfinite(schur).all() and gain > 0.0):
        return None
    return _Normal(
        rss=max(float(schur[-1, -1]), 0.0),
        gain=gain,
        offset=offset,
        hessian=gain * gain * schur[:PARAMETERS, :PARAMETERS],
        gradient=gain * schur[:PARAMETERS, -1],
    )


def _normal_equations(phantom: Phantom, data: SinogramData, x: FloatArray) -> _Normal | None:
    """At x = (psi, R, SDD, u_c, tau, t_x, t_y); None where no such geometry exists or it shows nothing."""
    if not np.isfinite(x).all() or abs(x[4]) > 1.4 or x[1] <= 0.0 or x[2] <= x[1]:
        return None
    frame = SourceFrame.from_vector(x[:5])
    if not analytic.clears(phantom.radius_mm + math.hypot(x[5], x[6]), frame):
        return None
    grams = analytic.gram(
        phantom,
        data.cells,
        frame,
        data.angles_rad,
        data.sinogram,
        position_mm=(x[5], x[6]),
        rays_per_cell=data.rays_per_cell,
    )
    return _eliminate(grams.sum(axis=0))


def refine(
    phantom: Phantom,
    data: SinogramData,
    start: SourceFrame,
    *,
    position_mm: tuple[float, float] = (0.0, 0.0),
    fixed_source_distance: bool = False,
    max_iterations: int = 60,
) -> Fit | None:
    """Go from a start in the right valley to its bottom.

    Parameters
    ----------
    phantom : Phantom
        As this hypothesis of handedness sees it.
    start : SourceFrame
        Where to begin; with `fixed_source_distance` R stays there.

    Returns
    -------
    Fit or None
        None where the start explains nothing: no shadow on the detector, or a gain that is not positive.
    """
    centre = float(data.sinogram.mean())
    centred = SinogramData(data.sinogram - centre, data.angles_rad, data.cells, data.rays_per_cell)
    free = np.array([i for i in range(PARAMETERS) if not (fixed_source_distance and i == R_INDEX)])
    x = np.concatenate([start.to_vector(), position_mm])
    now = _normal_equations(phantom, centred, x)
    if now is None:
        return None
    damping, converged, iterations = 1e-3, False, 0
    while iterations < max_iterations:
        iterations += 1
        hessian = now.hessian[np.ix_(free, free)]
        damped = hessian + damping * np.diag(np.diag(hessian))
        try:
            step = np.linalg.solve(damped, now.gradient[free])
        except np.linalg.LinAlgError:  # a direction the data do not see at all: damp harder
            step = np.full(free.size, np.nan)
        trial = x.copy()
        trial[free] += step
        then = _normal_equations(phantom, centred, trial)
        if then is not None and then.rss <= now.rss:
            gained = float(step @ now.gradient[free])
            x, now, damping = trial, then, max(damping * 0.1, 1e-12)
            # The expected gain against the residual: a step far below the noise's own uncertainty changes nothing.
            if gained <= 1e-9 * max(now.rss, 1e-14 * float((centred.sinogram**2).sum())):
                converged = True
                break
        else:
            damping = max(damping * 10.0, 1e-9)
            if damping > 1e8:
                converged = then is not None and abs(then.rss - now.rss) <= 1e-9 * now.rss
                break
    return _fit(centred, x, now, free, centre, converged=converged, iterations=iterations)


def _fit(
    data: SinogramData,
    x: FloatArray,
    normal: _Normal,
    free: np.ndarray,
    centre: float,
    *,
    converged: bool,
    iterations: int,
) -> Fit:
    count = data.sinogram.size
    degrees = max(count - free.size - 2, 1)
    covariance = np.zeros((PARAMETERS, PARAMETERS))
    # The diagonal is scaled to one before inverting: radians and millimetres differ by 1e4.
    hessian = normal.hessian[np.ix_(free, free)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    covariance[np.ix_(free, free)] = inverse * normal.rss / degrees
    residual_rms = math.sqrt(normal.rss / count)
    total = math.sqrt(float((data.sinogram**2).mean()))
    return Fit(
        frame=SourceFrame.from_vector(x[:5]),
        position_mm=(float(x[5]), float(x[6])),
        gain=normal.gain,
        offset=normal.offset + centre,
        covariance=covariance,
        residual_rms=residual_rms,
        relative_residual=residual_rms / total if total > 0.0 else math.inf,
        converged=converged,
        iterations=iterations,
    )
