"""SIRT and CGLS of the ASTRA toolbox on a CPU, as its own algorithms run them: one thread, one slice after another.

The rays' lengths of its line projector are kept as its sparse matrix: the images are the same, five times as fast. The
number of iterations is chosen with the truth in hand: they run on until the error has risen.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import astra
import numpy as np

from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.quality import relative_error

# The iterations after which the error is computed. SIRT changes slowly, CGLS has passed its best after some.
STOPS = {
    "SIRT": (5, 10, 15, 20, 30, 40, 55, 75, 100, 140, 200, 280, 400),
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
        A slice, up to that number, by the processor and by the clock; without the matrix, which is made once a log.
    """

    images: Image
    iterations: int
    cpu_s: float
    wall_s: float


def tuned(algorithm: str, projector: Projector, lines: Image, truth: Image, stops: Sequence[int]) -> Tuned:
    """Run SIRT, which keeps to attenuation of at least 0, or CGLS, whose image is clipped there.

    Parameters
    ----------
    algorithm : {"SIRT", "CGLS"}
    lines : (slices, views, detector) float32
    truth : (slices, size, size) float32
    stops : sequence of int
        The numbers of iterations to choose from, ascending.
    """
    found: Tuned | None = None
    least = np.inf
    with _matrix(projector) as matrix:
        courses = [_course(algorithm, matrix, line, stops) for line in lines]
        for steps in zip(*courses, strict=True):
            images = np.stack([step.image for step in steps])
            error = float(np.mean([relative_error(image, true) for image, true in zip(images, truth, strict=True)]))
            if error >= least:
                break
            least = error
            cpu, wall = (float(np.mean([getattr(step, name) for step in steps])) for name in ("cpu_s", "wall_s"))
            found = Tuned(images, steps[0].iterations, cpu, wall)
        for course in courses:
            course.close()
    assert found is not None
    return found


class _Matrix(NamedTuple):
    """ASTRA's volume and projection geometries, and the number of the projector."""

    volumes: dict[str, Any]
    rays: dict[str, Any]
    kernel: int


@contextmanager
def _matrix(projector: Projector) -> Iterator[_Matrix]:
    """Yield the line projector's rays as a sparse matrix, for a field around the COR."""
    half, grid = 0.5 * projector.grid.field_mm, projector.grid
    volumes = astra.create_vol_geom(grid.size, grid.size, -half, half, -half, half)
    views, cells = projector.geometry.sinogram_shape
    fan = astra.create_proj_geom("fanflat_vec", cells, projector.geometry.astra_vectors())
    tracing = astra.create_projector("line_fanflat", fan, volumes)
    matrix = astra.projector.matrix(tracing)
    # Width of a cell and angles are not used: the matrix holds the rays.
    rays = astra.create_proj_geom("sparse_matrix", 1.0, cells, np.zeros(views), matrix)
    kernel = astra.create_projector("sparse_matrix", rays, volumes)
    try:
        yield _Matrix(volumes, rays, kernel)
    finally:
        astra.projector.delete([kernel, tracing])
        astra.matrix.delete(matrix)


class _Step(NamedTuple):
    """A slice at a stop, and what it took until then."""

    iterations: int
    image: Image
    cpu_s: float
    wall_s: float


def _course(algorithm: str, matrix: _Matrix, line: Image, stops: Sequence[int]) -> Generator[_Step, None, None]:
    """Reconstruct one slice, stop by stop."""
    with _run(algorithm, matrix, line) as (run, volume):
        cpu, wall, done = 0.0, 0.0, 0
        for stop in stops:
            cpu_before, wall_before = time.process_time(), time.perf_counter()
            astra.algorithm.run(run, stop - done)
            cpu, wall = cpu + time.process_time() - cpu_before, wall + time.perf_counter() - wall_before
            done = stop
            yield _Step(done, np.maximum(astra.data2d.get(volume), 0.0), cpu, wall)


@contextmanager
def _run(algorithm: str, matrix: _Matrix, line: Image) -> Iterator[tuple[int, int]]:
    """Yield the numbers of ASTRA's algorithm and image."""
    data, image = astra.data2d.create("-sino", matrix.rays, line), astra.data2d.create("-vol", matrix.volumes, 0.0)
    settings = astra.astra_dict(algorithm)
    settings |= {"ProjectorId": matrix.kernel, "ProjectionDataId": data, "ReconstructionDataId": image}
    if algorithm == "SIRT":
        settings["option"] = {"MinConstraint": 0.0}
    run = astra.algorithm.create(settings)
    try:
        yield run, image
    finally:
        astra.algorithm.delete(run)
        astra.data2d.delete([data, image])
