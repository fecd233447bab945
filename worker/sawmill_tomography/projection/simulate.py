"""Simulated scans, line integrals or counts: never through the discrete projector that reconstructs them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.physics.simulate import FIELDS, simulate_physics
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary.physics import DetectorEffects, Physics

RAYS_PER_CELL = 8
# Default effects of every detector: gains that differ by 3 %.
UNEQUAL_CELLS = Physics(detector=DetectorEffects(gain_spread=0.03))


def simulate_sinogram(
    phantom: Phantom,
    geometry: FanBeamGeometry,
    *,
    noise: float = 0.0,
    background: float = 0.0,
    rays_per_cell: int = RAYS_PER_CELL,
    seed: int,
) -> FloatArray:
    """Simulate line integrals (views, detector) with Gaussian noise.

    Parameters
    ----------
    noise : float
        Standard deviation, relative to the RMS of the noise-free sinogram.
    background : float
        Constant that is added to every sample, in the sinogram's unit.
    """
    if not (math.isfinite(noise) and noise >= 0.0):
        raise GeometryError(f"noise must be a share of the RMS, zero or more, not {noise}")
    cells = DetectorCells.of(geometry.scanner)
    clean = analytic.project(phantom, cells, geometry.frame, geometry.angles_rad, rays_per_cell=rays_per_cell)
    rms = math.sqrt(float(np.mean(clean**2)))
    return clean + background + noise * rms * np.random.default_rng(seed).standard_normal(clean.shape)


def simulate_rows(
    slices: list[Phantom], geometry: FanBeamGeometry, *, noise: float = 0.0, background: float = 0.0, seed: int
) -> NDArray[np.float32]:
    """Simulate line integrals (views, rows, detector) float32, a cross-section a row; row n has the seed `seed` + n."""
    sinograms = [
        simulate_sinogram(body, geometry, noise=noise, background=background, seed=seed + row)
        for row, body in enumerate(slices)
    ]
    return np.stack(sinograms, axis=1).astype(np.float32)


@dataclass(frozen=True)
class SimulatedStack:
    """Raw counts with flat and dark fields, as a scanner writes them: (views or fields, rows, detector) uint16."""

    counts: NDArray[np.uint16]
    flats: NDArray[np.uint16]
    darks: NDArray[np.uint16]


def simulate_stack(
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    physics: Physics = UNEQUAL_CELLS,
    *,
    photons: float = 30_000.0,
    fields: int = FIELDS,
    seed: int,
) -> SimulatedStack:
    """Simulate counts of a stack of cross-sections, densities in attenuation per mm, with the effects of a mill.

    The detector sums intensity over each cell: exp(-p) is averaged over the rays, not p. Air gives `photons` counts,
    photon noise is Poisson, dark noise Gaussian. The rows share the motion and the tube; each has its own cells.

    Raises
    ------
    GeometryError, PhantomError
        Error of `simulate_physics`.
    """
    rows = [
        simulate_physics(
            body,
            geometry.scanner,
            geometry.frame,
            geometry.angles_rad,
            physics,
            photons=photons,
            fields=fields,
            seed=seed,
            row=row,
        )
        for row, body in enumerate(slices)
    ]
    counts, flats, darks = (
        np.stack(images, axis=1) for images in zip(*((row.counts, row.flats, row.darks) for row in rows), strict=True)
    )
    return SimulatedStack(counts, flats, darks)
