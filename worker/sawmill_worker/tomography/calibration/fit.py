"""Least squares on the sinogram: Levenberg-Marquardt with gain, background and other linear terms eliminated.

min over (psi, R, SDD, u_c, tau, t_x, t_y) of || g * proj(phantom at t) + b - y ||^2, g and b in closed form (variable
projection with Kaufman's derivative; Golub and Pereyra 2003). Every inner product that this needs comes from the
per-view Gram matrices of `analytic.gram`, so no derivative is ever stored.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import PARAMETERS, DetectorCells
from sawmill_worker.tomography.geometry import FloatArray, SourceFrame, wrap_angle
from sawmill_worker.tomography.phantom import Phantom

R_INDEX = 1
# Positions in `analytic.gram` behind the derivatives.
MODEL, ONE, DATA, SQUARE = PARAMETERS, PARAMETERS + 1, PARAMETERS + 2, PARAMETERS + 3
MOMENTS = (PARAMETERS + 4, PARAMETERS + 5)


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
    weights : (views, cells) float64 or None
        Of each sample; None weighs all alike.
    hardening, density_gradient, view_gain : bool
        Whether p^2, the density's slopes over the phantom, and a gain and offset of each view's own are fitted beside
        one gain and one offset.
    blur_cells : float
        Standard deviation, in cells, of the model's blur along the detector.
    """

    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    rays_per_cell: int | None = None
    weights: FloatArray | None = None
    hardening: bool = False
    density_gradient: bool = False
    view_gain: bool = False
    blur_cells: float = 0.0

    @property
    def extras(self) -> list[int]:
        """Positions of the extra terms in `analytic.gram`."""
        return [SQUARE] * self.hardening + [*MOMENTS] * self.density_gradient

    @property
    def samples(self) -> float:
        """How many there are, by weight."""
        return self.sinogram.size if self.weights is None else float(self.weights.sum())

    def gram(self, phantom: Phantom, x: FloatArray, hardening: float, *, extended: bool | None = None) -> FloatArray:
        """`analytic.gram` at x = (psi, R, SDD, u_c, tau, t_x, t_y)."""
        options = analytic.GramOptions(
            self.weights, bool(self.extras) if extended is None else extended, hardening, self.blur_cells
        )
        return analytic.gram(
            phantom,
            self.cells,
            SourceFrame.from_vector(x[:5]),
            self.angles_rad,
            self.sinogram,
            position_mm=(x[5], x[6]),
            rays_per_cell=self.rays_per_cell,
            options=options,
        )


@dataclass(frozen=True)
class Fit:
    """Where least squares ended.

    Attributes
    ----------
    covariance : (7, 7) float64
        Of (psi, R, SDD, u_c, tau, t_x, t_y) for the noise that the residual shows; rows of fixed parameters are zero.
    residual_rms, relative_residual : float
        In the sinogram's unit, and against the RMS of the sinogram without its mean.
    hardening, gradient_per_mm
        The measured sinogram is gain (p + hardening p^2) and the density 1 + gradient . (x, y), where they were fitted.
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
    hardening: float = 0.0
    gradient_per_mm: tuple[float, float] = (0.0, 0.0)

    def to_vector(self) -> FloatArray:
        """(psi, R, SDD, u_c, tau, t_x, t_y)."""
        return np.concatenate([self.frame.to_vector(), self.position_mm])


@dataclass(frozen=True)
class _Normal:
    """The normal equations after gain, offset and what else is linear are eliminated."""

    rss: float
    gain: float
    offset: float
    hardening: float
    gradient_per_mm: tuple[float, float]
    hessian: FloatArray
    gradient: FloatArray


def project_out(gram: FloatArray, linear: list[int], kept: list[int]) -> tuple[FloatArray, FloatArray]:
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
    """Which views (views,) show the phantom, so that a gain of their own can be told, from Gram matrices of each."""
    shown: NDArray[np.bool_] = grams[:, MODEL, MODEL] > 1e-9 * grams[:, MODEL, MODEL].max()
    return shown


def reduce(grams: FloatArray, extras: list[int], kept: list[int], *, view_gain: bool) -> tuple[FloatArray, FloatArray]:
    """Gram matrix of `kept` after gain, offset and extras are projected out, and their coefficients for all views.

    With `view_gain` each view has a gain and an offset of its own; the coefficients are still the common ones.
    """
    total = grams.sum(axis=0)
    schur, coefficients = project_out(total, [MODEL, ONE, *extras], kept)
    if not view_gain:
        return schur, coefficients
    both = [*kept, *extras]
    seen = seen_views(grams)
    used = grams[:, ONE, ONE] > 0.0
    per_view = project_out(grams[seen], [MODEL, ONE], both)[0].sum(axis=0)
    per_view += project_out(grams[used & ~seen], [ONE], both)[0].sum(axis=0)
    count = len(kept)
    if extras:
        per_view, _ = project_out(per_view, list(range(count, len(both))), list(range(count)))
    return per_view, coefficients


def _eliminate(grams: FloatArray, data: SinogramData) -> _Normal | None:
    """Project what is linear out of derivatives and data; None where the model shows nothing."""
    kept = [*range(PARAMETERS), DATA]
    try:
        schur, solved = reduce(grams, data.extras, kept, view_gain=data.view_gain)
    except np.linalg.LinAlgError:  # the model is zero, or the same everywhere
        return None
    coefficients = dict(zip([MODEL, ONE, *data.extras], solved[:, -1].tolist(), strict=True))
    gain = coefficients[MODEL]
    if not (np.isfinite(schur).all() and gain > 0.0):
        return None
    return _Normal(
        rss=max(float(schur[-1, -1]), 0.0),
        gain=gain,
        offset=coefficients[ONE],
        hardening=coefficients.get(SQUARE, 0.0) / gain,
        gradient_per_mm=(coefficients.get(MOMENTS[0], 0.0) / gain, coefficients.get(MOMENTS[1], 0.0) / gain),
        hessian=gain * gain * schur[:PARAMETERS, :PARAMETERS],
        gradient=gain * schur[:PARAMETERS, -1],
    )


def _normal_equations(phantom: Phantom, data: SinogramData, x: FloatArray, hardening: float) -> _Normal | None:
    """At x = (psi, R, SDD, u_c, tau, t_x, t_y); None where no such geometry exists or it shows nothing."""
    if not np.isfinite(x).all() or abs(x[4]) > 1.4 or x[1] <= 0.0 or x[2] <= x[1]:
        return None
    if not analytic.clears(phantom.radius_mm + math.hypot(x[5], x[6]), SourceFrame.from_vector(x[:5])):
        return None
    return _eliminate(data.gram(phantom, x, hardening), data)


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
    centre = float(np.average(data.sinogram, weights=data.weights))
    centred = replace(data, sinogram=data.sinogram - centre)
    free = np.array([i for i in range(PARAMETERS) if not (fixed_source_distance and i == R_INDEX)])
    x = np.concatenate([start.to_vector(), position_mm])
    now = _normal_equations(phantom, centred, x, 0.0)
    if now is None:
        return None
    power = float(np.average(centred.sinogram**2, weights=data.weights)) * centred.sinogram.size
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
        then = _normal_equations(phantom, centred, trial, now.hardening)
        if then is not None and then.rss <= now.rss:
            gained = float(step @ now.gradient[free])
            x, now, damping = trial, then, max(damping * 0.1, 1e-12)
            # The expected gain against the residual: a step far below the noise's own uncertainty changes nothing.
            if gained <= 1e-9 * max(now.rss, 1e-14 * power):
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
    count = data.samples
    linear = 2 * len(data.sinogram) if data.view_gain else 2
    degrees = max(count - free.size - linear - len(data.extras), 1.0)
    covariance = np.zeros((PARAMETERS, PARAMETERS))
    # The diagonal is scaled to one before inverting: radians and millimetres differ by 1e4.
    hessian = normal.hessian[np.ix_(free, free)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    covariance[np.ix_(free, free)] = inverse * normal.rss / degrees
    residual_rms = math.sqrt(normal.rss / count)
    total = math.sqrt(float(np.average(data.sinogram**2, weights=data.weights)))
    return Fit(
        frame=SourceFrame.from_vector((wrap_angle(x[0]), *x[1:5])),
        position_mm=(float(x[5]), float(x[6])),
        gain=normal.gain,
        offset=normal.offset + centre,
        covariance=covariance,
        residual_rms=residual_rms,
        relative_residual=residual_rms / total if total > 0.0 else math.inf,
        converged=converged,
        iterations=iterations,
        hardening=normal.hardening,
        gradient_per_mm=normal.gradient_per_mm,
    )
