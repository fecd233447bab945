"""How far the rays of one geometry are from another's: the headline number (docs/conventions.md#ray-error)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography.geometry import (
    FloatArray,
    GeometryError,
    Scanner,
    SourceFrame,
    cell_centres_mm,
    to_vector,
)

POINTS_PER_CHORD = 9
DRAWS = 8192


@dataclass(frozen=True)
class RayError:
    """Distances in mm inside the disc, after the one common rotation that makes their RMS least."""

    rms_mm: float
    max_mm: float


def _rays(scanner: Scanner, frame: SourceFrame) -> tuple[FloatArray, FloatArray]:
    """Source (2,) and unit ray directions (cells, 2) of the view at which the source lies on -y."""
    w = cell_centres_mm(scanner) - frame.cor_column_mm
    a = np.stack([w * np.cos(frame.tilt_rad), frame.source_to_detector_mm + w * np.sin(frame.tilt_rad)], -1)
    return np.array([0.0, -frame.source_distance_mm]), a / np.hypot(a[:, 0], a[:, 1])[:, None]


def chord_points(scanner: Scanner, frame: SourceFrame, radius_mm: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Nine equidistant points of the chord that each ray cuts from the disc.

    Returns
    -------
    points : (rays, 9, 2) mm
    cells : (rays,) int
        The detector cells whose rays meet the disc.

    Raises
    ------
    GeometryError
        If no ray meets the disc.
    """
    source, direction = _rays(scanner, frame)
    along = -(direction @ source)
    half = radius_mm**2 - (source @ source - along**2)
    cells = np.flatnonzero(half > 0.0)
    if cells.size == 0:
        raise GeometryError(f"no ray of this geometry meets the disc of radius {radius_mm:.4g} mm")
    half = np.sqrt(half[cells])
    s = along[cells, None] + half[:, None] * np.linspace(-1.0, 1.0, POINTS_PER_CHORD)
    return source + s[..., None] * direction[cells, None, :], cells


def _distances(
    scanner: Scanner, frame: SourceFrame, points: FloatArray, cells: NDArray[np.intp], omega: float
) -> tuple[FloatArray, FloatArray]:
    """Signed distances of the points to the frame's rays turned by omega, and their derivative by omega."""
    source, direction = _rays(scanner, frame)
    normal = np.stack([-direction[:, 1], direction[:, 0]], -1)[cells]
    c, s = np.cos(omega), np.sin(omega)
    back = points @ np.array([[c, -s], [s, c]])
    d = np.einsum("rc,rpc->rp", normal, back - source)
    slope = np.einsum("rc,rpc->rp", normal, np.stack([back[..., 1], -back[..., 0]], -1))
    return d, slope


def ray_error(scanner: Scanner, true: SourceFrame, other: SourceFrame, *, radius_mm: float = 150.0) -> RayError:
    """RMS and maximum distance between the rays of two geometries inside a disc around the COR.

    Free of theta's gauge (the twin has 0); psi is not seen, because one common rotation is taken out.
    """
    points, cells = chord_points(scanner, true, radius_mm)
    omega = 0.0
    for _ in range(20):
        d, slope = _distances(scanner, other, points, cells, omega)
        step = -float((d * slope).sum() / (slope * slope).sum())
        omega += step
        if abs(step) < 1e-15:
            break
    d, _ = _distances(scanner, other, points, cells, omega)
    return RayError(float(np.sqrt(np.mean(d * d))), float(np.abs(d).max()))


def scale_ray_error(scanner: Scanner, frame: SourceFrame, size_tolerance: float, *, radius_mm: float = 150.0) -> float:
    """RMS ray error, mm, of a geometry from a phantom that is larger than stated by its size tolerance.

    Such a phantom makes R larger by as much and nothing else (docs/geometry.md#the-scale).
    """
    larger = replace(frame, source_distance_mm=frame.source_distance_mm * (1.0 + size_tolerance))
    return ray_error(scanner, frame, larger, radius_mm=radius_mm).rms_mm


@dataclass(frozen=True)
class PredictedRayError:
    """What a covariance says the rays are off by inside the disc.

    Attributes
    ----------
    rms_mm : float
        Root of the expected mean square.
    max_mm : float
        Standard deviation at the worst point.
    upper_95_mm : float
        The RMS ray error stays below this in 95 of 100 cases.
    interval_95_mm : (low, high)
        Between these in 95 of 100 cases.
    """

    rms_mm: float
    max_mm: float
    upper_95_mm: float
    interval_95_mm: tuple[float, float]


def predicted_ray_error(
    scanner: Scanner, frame: SourceFrame, covariance: FloatArray, *, radius_mm: float = 150.0
) -> PredictedRayError:
    """The ray error that a covariance of (psi, R, SDD, u_c, tau) predicts, to first order.

    The mean square of the ray error is a quadratic form in the parameters' errors, with the mean outer product of each
    point's derivatives; the common rotation is projected out of them as `ray_error` takes it out of the distances.
    """
    points, cells = chord_points(scanner, frame, radius_mm)
    vector = to_vector(frame)
    steps = np.array([1e-6, 1e-3, 1e-3, 1e-3, 1e-6])
    columns = []
    for index in range(1, 5):
        up, down = vector.copy(), vector.copy()
        up[index] += steps[index]
        down[index] -= steps[index]
        high, _ = _distances(scanner, SourceFrame.from_vector(up), points, cells, 0.0)
        low, _ = _distances(scanner, SourceFrame.from_vector(down), points, cells, 0.0)
        columns.append((high - low).ravel() / (2.0 * steps[index]))
    derivative = np.stack(columns, -1)
    _, slope = _distances(scanner, frame, points, cells, 0.0)
    turn = slope.ravel()
    derivative -= np.outer(turn, turn @ derivative / (turn @ turn))
    variance = np.einsum("pi,ij,pj->p", derivative, covariance[1:, 1:], derivative)
    form = derivative.T @ derivative / len(derivative)
    values, vectors = np.linalg.eigh(covariance[1:, 1:])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    weights = np.maximum(np.linalg.eigvalsh(root.T @ form @ root), 0.0)
    # A sum of weighted chi-squares has no closed quantile: seeded draws give it to 1 %.
    squares = np.random.default_rng(0).standard_normal((DRAWS, weights.size)) ** 2 @ weights
    low, upper, high = np.sqrt(np.quantile(squares, [0.025, 0.95, 0.975])).tolist()
    return PredictedRayError(
        float(np.sqrt(max(variance.mean(), 0.0))),
        float(np.sqrt(max(variance.max(), 0.0))),
        upper,
        (low, high),
    )
