"""Initial guesses of the geometry: guesses that cast the measured shadow, and random guesses where that is not enough.

Over a full turn the phantom's farthest point sweeps a disc of the phantom's radius, so the shadow of all views together
reaches from -gamma to +gamma with sin gamma = radius / R. For each (R, tau) that fixes SDD and u_c. A few values of R,
along which the basin is long and flat, and of tau remain to be tried.
"""

import math

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.analytic import DetectorCells

DISTANCES, TILTS = 2, 9
# The largest tilt of a guess; least squares may exceed this tilt.
WIDEST_TILT = 1.2
# A cell belongs to the shadow where the strongest twentieth of the views reaches this share of the deepest shadow.
SHADOW_LEVEL, STRONGEST = 0.06, 0.05


def shadow_extent(sinogram: FloatArray, cells: DetectorCells) -> tuple[float, float] | None:
    """Find where the shadow of all views together begins and ends on the detector, mm; None without a shadow."""
    low, high = np.percentile(sinogram, [2.0, 99.5])
    air = float(np.median(sinogram[sinogram <= low + 0.1 * (high - low)]))
    strongest = max(1, round(STRONGEST * len(sinogram)))
    depth = np.sort(sinogram, axis=0)[-strongest:].mean(axis=0) - air
    covered = np.flatnonzero(depth > SHADOW_LEVEL * (high - air))
    if covered.size == 0:
        return None
    ends = cells.first_border_mm + cells.width_mm * np.array([covered[0], covered[-1] + 1])
    return float(ends[0]), float(ends[1])


def shadow_guesses(
    extent: tuple[float, float], phantom_radius_mm: float, distances: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return guesses of (R, ln M, u_c, tau), (guesses, 4), for R between `distances`; `rng` shifts the grid."""
    left, right = extent
    shift_r, shift_tau = rng.uniform(0.0, 1.0, 2)
    guesses = []
    for r in distances[0] + (np.arange(DISTANCES) + shift_r) / DISTANCES * (distances[1] - distances[0]):
        gamma = math.asin(min(phantom_radius_mm / r, 0.95))
        for tau in -WIDEST_TILT + (np.arange(TILTS) + shift_tau) / TILTS * 2.0 * WIDEST_TILT:
            if math.cos(gamma + abs(tau)) < 0.05:
                continue
            far = math.sin(gamma) / math.cos(gamma + tau)
            near = -math.sin(gamma) / math.cos(gamma - tau)
            sdd = (right - left) / (far - near)
            if sdd > r:
                guesses.append((r, math.log(sdd / r), right - sdd * far, tau))
    return np.array(guesses, np.float64).reshape(-1, 4)


def random_guesses(box: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw a Latin hypercube of `count` guesses (R, ln M, u_c, tau) in the box (4, 2)."""
    strata = rng.permuted(np.tile(np.arange(count), (4, 1)), axis=1).T
    guesses: FloatArray = box[:, 0] + (strata + rng.uniform(size=(count, 4))) / count * (box[:, 1] - box[:, 0])
    return guesses
