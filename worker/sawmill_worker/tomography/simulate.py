"""Simulated scans from analytic projections: never through the discrete projector that reconstructs them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import DetectorCells
from sawmill_worker.tomography.geometry import FanBeamGeometry, FloatArray, GeometryError
from sawmill_worker.tomography.phantom import Phantom

RAYS_PER_CELL = 8


def simulate_sinogram(
    phantom: Phantom,
    geometry: FanBeamGeometry,
    *,
    noise: float = 0.0,
    background: float = 0.0,
    rays_per_cell: int = RAYS_PER_CELL,
    seed: int,
) -> FloatArray:
    """Line integrals (views, detector) with Gaussian noise.

    Parameters
    ----------
    noise : float
        Standard deviation, relative to the RMS of the noise-free sinogram.
    background : float
        Added everywhere, in the sinogram's unit.
    """
    if not (math.isfinite(noise) and noise >= 0.0):
        raise GeometryError(f"noise must be a share of the RMS, zero or more, not {noise}")
    cells = DetectorCells.of(geometry.scanner)
    clean = analytic.project(phantom, cells, geometry.frame, geometry.angles_rad, rays_per_cell=rays_per_cell)
    rms = math.sqrt(float(np.mean(clean**2)))
    rng = np.random.default_rng(seed)
    return clean + background + noise * rms * rng.standard_normal(clean.shape)


def simulate_rows(
    slices: list[Phantom], geometry: FanBeamGeometry, *, noise: float = 0.0, background: float = 0.0, seed: int
) -> NDArray[np.float32]:
    """Line integrals (views, rows, detector) float32, one cross-section a row; row n has the seed `seed` + n."""
    sinograms = [
        simulate_sinogram(body, geometry, noise=noise, background=background, seed=seed + row)
        for row, body in enumerate(slices)
    ]
    return np.stack(sinograms, axis=1).astype(np.float32)


@dataclass(frozen=True)
class SimulatedStack:
    """Raw counts with flat and dark fields, as a scanner writes them: (views or frames, rows, detector) uint16."""

    counts: NDArray[np.uint16]
    flats: NDArray[np.uint16]
    darks: NDArray[np.uint16]


def simulate_stack(
    slices: list[Phantom],
    geometry: FanBeamGeometry,
    *,
    photons: float = 30_000.0,
    dark_level: float = 200.0,
    frames: int = 10,
    seed: int,
) -> SimulatedStack:
    """Counts of a stack of cross-sections whose densities are attenuation per mm.

    The detector sums intensity over each cell: exp(-p) is averaged over the rays, not p. Air gives `photons` counts
    (below 2**16 less the dark level), cell gains differ by 3 %, photon noise is Poisson, dark noise Gaussian.
    """
    if photons + dark_level > 60_000.0:
        raise GeometryError(f"photons {photons:g} and dark_level {dark_level:g} do not fit 16 bits: 60000 in all")
    rng = np.random.default_rng(seed)
    scanner = geometry.scanner
    views, cells, rows = geometry.angles_rad.size, scanner.num_detector_pixels, len(slices)
    gain = 1.0 + 0.03 * rng.standard_normal((rows, cells)).clip(-3.0, 3.0)
    fine = DetectorCells(
        DetectorCells.of(scanner).first_border_mm, scanner.detector_pitch_mm / RAYS_PER_CELL, cells * RAYS_PER_CELL
    )

    def expose(mean: FloatArray) -> NDArray[np.uint16]:
        electronic = dark_level + 5.0 * rng.standard_normal(mean.shape)
        return np.rint(rng.poisson(mean) + electronic).clip(0, 65535).astype(np.uint16)

    counts = np.empty((views, rows, cells), np.uint16)
    for row, body in enumerate(slices):
        integrals = analytic.project(body, fine, geometry.frame, geometry.angles_rad, rays_per_cell=1)
        transmission = np.exp(-integrals).reshape(views, cells, RAYS_PER_CELL).mean(axis=2)
        counts[:, row] = expose(photons * gain[row] * transmission)
    flats = np.stack([expose(photons * gain) for _ in range(frames)])
    darks = np.stack([expose(np.zeros((rows, cells))) for _ in range(frames)])
    return SimulatedStack(counts, flats, darks)
