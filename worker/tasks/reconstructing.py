"""A reconstruction from sinograms in memory: what the job and the command line share."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from worker.contracts.base import Handedness, Rotation
from worker.contracts.geometry import ScannerConstants, Theta
from worker.contracts.jobs import Progress
from worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from worker.tasks.conversion import to_scanner, to_theta
from worker.tomography import geometry
from worker.tomography.fbp import fbp
from worker.tomography.filters import FilterName
from worker.tomography.geometry import FanBeamGeometry, FloatArray
from worker.tomography.image_grid import ImageGrid
from worker.tomography.projector import Projector

Report = Callable[[Progress], None]


@dataclass(frozen=True)
class ReconstructionInput:
    """What is reconstructed: sinograms (views, rows, detector) and the geometry they were taken with."""

    line_integrals: NDArray[np.float32]
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    theta: Theta
    rotation: Rotation
    handedness: Handedness
    input_sha256: str
    unit: str


def volume_unit(*, counts: bool) -> str:
    """The unit of a volume: counts give attenuation per mm; line integrals keep the unit they were given in."""
    return "1/mm" if counts else "line integral/mm"


def run_reconstruction(
    given: ReconstructionInput, options: ReconstructionOptions, report: Report
) -> tuple[NDArray[np.float32], ReconstructionResult]:
    """Reconstruct each row: the volume (slice, x, y) float32, and the answer beside it."""
    started = time.perf_counter()
    angles = geometry.Rotation(given.rotation).apply(given.angles_rad)
    grid = ImageGrid(options.size, options.field_mm)
    projector = Projector(FanBeamGeometry(to_scanner(given.scanner), to_theta(given.theta), angles), grid)
    slices = given.line_integrals.shape[1]
    volume = np.empty((slices, options.size, options.size), np.float32)
    for index in range(slices):
        volume[index] = fbp(
            projector,
            given.line_integrals[:, index],
            filter_name=FilterName(options.filter),
            frequency_scaling=options.frequency_scaling,
            weighting=options.weighting,
        )
        report(Progress(fraction=(index + 1) / (slices + 1), stage="reconstruct"))
    low, high = np.percentile(volume, [0.1, 99.9])
    return volume, ReconstructionResult(
        shape=volume.shape,
        pixel_mm=grid.pixel_mm,
        unit=given.unit,
        value_range=(float(low), float(high)),
        theta=given.theta,
        rotation=given.rotation,
        handedness=given.handedness,
        views=int(angles.size),
        rows=given.rows,
        time_s=time.perf_counter() - started,
        software_version=version("sawmill-calibration"),
        input_sha256=given.input_sha256,
    )
