"""SIRT and CGLS of the ASTRA toolbox on its CPU projector, as its own algorithms run them: one thread, one slice.

The number of iterations is chosen with the truth in hand: they run on until the error has risen.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import astra
import numpy as np

from sawmill_worker.tomography.projector import Image, Projector
from sawmill_worker.tomography.quality import relative_error

# The iterations after which the error is looked at. SIRT changes slowly, CGLS has passed its best after some.
STOPS = {
    "SIRT": (5, 10, 15, 20, 30, 40, 55, 75, 100, 140, 200),
    "CGLS": (2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25, 30),
}


@dataclass(frozen=True, eq=False)
class Tuned:
    """The images of some slices after the number of iterations that is best for all of them together.

    Attributes
    ----------
    images : (slices, size, size) float32
    iterations : int
    cpu_s, wall_s : float
        A slice, up to that number, by the processor and by the clock.
    """

    images: Image
    iterations: int
    cpu_s: float
    wall_s: float


def astra_fan(projector: Projector) -> tuple[dict[str, Any], dict[str, Any], int]:
    """ASTRA's volume and projection geometries of a field around the COR, and the number of its CPU projector."""
    half, grid = 0.5 * projector.grid.field_mm, projector.grid
    volumes = astra.create_vol_geom(grid.size, grid.size, -half, half, -half, half)
    cells = projector.geometry.scanner.num_detector_pixels
    rays = astra.create_proj_geom("fanflat_vec", cells, projector.geometry.astra_vectors())
    return volumes, rays, astra.create_projector("line_fanflat", rays, volumes)


def tuned(algorithm: str, projector: Projector, lines: Image, truth: Image) -> Tuned:
    """SIRT, which keeps to attenuation of at least 0, or CGLS, whose image is clipped there.

    Parameters
    ----------
    algorithm : {"SIRT", "CGLS"}
    lines : (slices, views, detector) float32
    truth : (slices, size, size) float32
    """
    courses = [_course(algorithm, projector, line, STOPS[algorithm]) for line in lines]
    found: Tuned | None = None
    least = np.inf
    for steps in zip(*courses, strict=True):
        images = np.stack([step.image for step in steps])
        error = float(np.mean([relative_error(image, true) for image, true in zip(images, truth, strict=True)]))
        if error >= least:
            break
        least = error
        cpu, wall = (float(np.mean([getattr(step, name) for step in steps])) for name in ("cpu_s", "wall_s"))
        found = Tuned(images, steps[0].iterations, cpu, wall)
    assert found is not None
    return found


class _Step(NamedTuple):
    """A slice at a stop, and what it took until then."""

    iterations: int
    image: Image
    cpu_s: float
    wall_s: float


def _course(algorithm: str, projector: Projector, line: Image, stops: Sequence[int]) -> Iterator[_Step]:
    """One slice, stop by stop."""
    with _run(algorithm, projector, line) as (run, volume):
        cpu, wall, done = 0.0, 0.0, 0
        for stop in stops:
            cpu_before, wall_before = time.process_time(), time.perf_counter()
            astra.algorithm.run(run, stop - done)
            cpu, wall = cpu + time.process_time() - cpu_before, wall + time.perf_counter() - wall_before
            done = stop
            yield _Step(done, np.maximum(astra.data2d.get(volume), 0.0), cpu, wall)


@contextmanager
def _run(algorithm: str, projector: Projector, line: Image) -> Iterator[tuple[int, int]]:
    """The numbers of ASTRA's algorithm and of its image."""
    volumes, rays, kernel = astra_fan(projector)
    data, image = astra.data2d.create("-sino", rays, line), astra.data2d.create("-vol", volumes, 0.0)
    settings = astra.astra_dict(algorithm)
    settings |= {"ProjectorId": kernel, "ProjectionDataId": data, "ReconstructionDataId": image}
    if algorithm == "SIRT":
        settings["option"] = {"MinConstraint": 0.0}
    run = astra.algorithm.create(settings)
    try:
        yield run, image
    finally:
        astra.algorithm.delete(run)
        astra.data2d.delete([data, image])
        astra.projector.delete(kernel)
