"""A stack of rows as a mill's scanner records it."""

import numpy as np

from sawmill_worker.tomography.geometry import FanBeamGeometry
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.physics.simulate import simulate_physics
from sawmill_worker.tomography.simulate import SimulatedStack
from sawmill_worker.vocabulary.physics import Physics


def simulate_physics_stack(
    slices: list[Phantom], geometry: FanBeamGeometry, physics: Physics, *, photons: float = 30_000.0, seed: int
) -> SimulatedStack:
    """Counts of a stack, one cross-section a row, densities in attenuation per mm.

    The rows share the motion and the tube; each has its own cells and photons.

    Raises
    ------
    GeometryError, PhantomError
        As `simulate_physics`.
    """
    rows = [
        simulate_physics(
            body, geometry.scanner, geometry.frame, geometry.angles_rad, physics, photons=photons, seed=seed, row=row
        )
        for row, body in enumerate(slices)
    ]
    counts, flats, darks = (
        np.stack(images, axis=1) for images in zip(*((row.counts, row.flats, row.darks) for row in rows), strict=True)
    )
    return SimulatedStack(counts, flats, darks)
