"""A reconstruction from rows to a volume's file, block by block: what the job and the command line share."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.geometry import ScannerConstants, Theta
from sawmill_worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_worker.tomography import cost
from sawmill_worker.tomography.choosing import recommend
from sawmill_worker.tomography.geometry import FanBeamGeometry, FloatArray
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.object_extent import object_radius_mm
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.tomography.stack import reconstruct_stack
from sawmill_worker.use_cases.conversion import to_scanner, to_theta
from sawmill_worker.use_cases.room import check_disk, memory_available
from sawmill_worker.use_cases.solving import Work, solver_of
from sawmill_worker.use_cases.value_range import ValueRange
from sawmill_worker.use_cases.writing_volumes import VolumeOrigin, new_volume
from sawmill_worker.vocabulary import Handedness, Progress, ProgressCallback, ReconstructionMethod, Rotation

# Line integrals (views, stop - start, detector) of the slices start..stop.
ReadRows = Callable[[int, int], NDArray[np.float32]]

# Of what is free, the blocks take at most this share: the rest is for the files' caches and for others.
MEMORY_SHARE = 0.5
# Within the first block the pace is told once this share of all is done, or so many seconds have passed.
PACE_SHARE, PACE_SECONDS = 0.05, 2.0
# A log tapers, bends and flares at its butt: so many rows along it are looked at for how far it reaches.
ROWS_LOOKED_AT = 17


@dataclass(frozen=True)
class ReconstructionInput:
    """What is reconstructed: line integrals, read as they are needed, and the geometry they were taken with.

    Attributes
    ----------
    read : callable
        (views, rows, detector) float32 of the slices start..stop.
    counts : bool
        Whether they were made from counts: the volume is then in 1/mm.
    rows, row_step
        The scan's rows, the first included, the last not, and every which of them is a slice.
    preparation : tuple of str
        What was done to the scan's data before.
    """

    read: ReadRows
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    theta: Theta
    rotation: Rotation
    handedness: Handedness
    input_sha256: str
    counts: bool
    preparation: tuple[str, ...] = ()
    row_step: int = 1


def volume_unit(*, counts: bool) -> str:
    """The unit of a volume: counts give attenuation per mm; line integrals keep the unit they were given in."""
    return "1/mm" if counts else "line integral/mm"


def run_reconstruction(
    given: ReconstructionInput, options: ReconstructionOptions, output: Path, report: ProgressCallback
) -> ReconstructionResult:
    """Reconstruct each row into the volume's file, which is there when all of it is; and the answer beside it.

    Raises
    ------
    GeometryError, JobFailure
        The geometry or the options cannot be used, or the volume does not fit into the memory or on the disk.
    OSError
        The file cannot be written.
    """
    started = time.perf_counter()
    angles = given.rotation.apply(given.angles_rad)
    grid = ImageGrid(options.size, options.field_mm, options.field_centre_mm)
    projector = Projector(FanBeamGeometry(to_scanner(given.scanner), to_theta(given.theta), angles), grid)
    slices = len(range(*given.rows, given.row_step))
    shape = (slices, options.size, options.size)
    volumes = 2 if options.uncertainty else 1
    check_disk(output.parent, shape, volumes * cost.volume_bytes(options.size, slices))
    reporting = _Reporting(slices, report)
    sample = np.ascontiguousarray(given.read(slices // 2, slices // 2 + 1)[:, 0])
    method, reason = _method(options, projector, sample)
    reporting.foretell(_predicted(projector, slices, method))
    work = Work(
        options=options,
        projector=projector,
        sample=sample,
        radius_mm=_radius_mm(given.read, projector.geometry, slices),
        slices=slices,
        middle_row=given.rows[0] + slices // 2 * given.row_step,
        counts=given.counts,
        memory_bytes=int(MEMORY_SHARE * memory_available()),
        reason=reason,
        told=reporting.within,
    )
    solver = solver_of(method, work)
    seen = ValueRange(slices, options.size)
    origin = VolumeOrigin(
        given.scanner,
        given.theta,
        given.rotation,
        given.handedness,
        given.rows,
        given.input_sha256,
        given.preparation,
        given.row_step,
    )
    unit = volume_unit(counts=given.counts)
    with new_volume(output, shape, origin, options, unit=unit, views=angles.size) as volume:

        def reconstruct(start: int, stop: int) -> Iterator[None]:
            rows = given.read(start, stop)
            yield
            block = solver(start, rows)
            yield
            volume.write(start, block.images)
            seen.add(block.images)
            if block.deviation is not None:
                volume.write_deviation(start, block.deviation)

        reconstruct_stack(slices, reconstruct, step=solver.step, abreast=solver.abreast, done=reporting)
        done = solver.report()
        volume.note_method(done.model_dump(mode="json", exclude_none=True))
        if solver.curve is not None:
            volume.note_alpha_curve(solver.curve)
    return ReconstructionResult(
        shape=shape,
        pixel_mm=grid.pixel_mm,
        unit=unit,
        value_range=seen.percentiles(),
        theta=given.theta,
        rotation=given.rotation,
        handedness=given.handedness,
        views=int(angles.size),
        rows=given.rows,
        row_step=given.row_step,
        time_s=time.perf_counter() - started,
        software_version=version("sawmill-calibration"),
        input_sha256=given.input_sha256,
        preparation=list(given.preparation),
        method=done,
        has_deviation=options.uncertainty,
    )


def _method(
    options: ReconstructionOptions, projector: Projector, sample: NDArray[np.float32]
) -> tuple[ReconstructionMethod, str | None]:
    """The method asked for; or the one that suits a sinogram of the scan, and why."""
    if options.method is not ReconstructionMethod.AUTO:
        return options.method, None
    recommended = recommend(projector.geometry, sample)
    return ReconstructionMethod(recommended.method), recommended.reason


def _radius_mm(read: ReadRows, geometry: FanBeamGeometry, slices: int) -> float:
    """Of the disc that holds what rows all along the log show, the first and the last included."""
    looked_at = {round(n) for n in np.linspace(0, slices - 1, ROWS_LOOKED_AT)}
    return max(object_radius_mm(geometry, read(n, n + 1)[:, 0]) for n in sorted(looked_at))


def _predicted(projector: Projector, slices: int, method: ReconstructionMethod) -> float | None:
    """Seconds, where they are known beforehand: an iterative method takes as many steps as the scan asks for."""
    if method is not ReconstructionMethod.FBP:
        return None
    views, cells = projector.geometry.sinogram_shape
    return cost.seconds(views, cells, projector.grid.size, slices)


class _Reporting:
    """Turns slices done into progress with the time left."""

    def __init__(self, slices: int, report: ProgressCallback) -> None:
        self._started, self._slices, self._report = time.perf_counter(), slices, report
        self._done = 0

    def foretell(self, seconds_left: float | None) -> None:
        """Say how long all of it will take, where that is known."""
        self._tell(0.0, seconds_left)

    def within(self, more: float) -> None:
        """So many slices' worth is done beyond those that are."""
        done = self._done + more
        paced = done >= PACE_SHARE * self._slices or (done > 0.0 and self._elapsed >= PACE_SECONDS)
        self._tell(done, self._left(done) if paced else None)

    def __call__(self, done: int) -> None:
        """So many slices are done."""
        self._done = done
        self._tell(done, self._left(done))

    @property
    def _elapsed(self) -> float:
        return time.perf_counter() - self._started

    def _left(self, done: float) -> float:
        return cost.seconds_left(self._elapsed, done, self._slices)

    def _tell(self, done: float, left: float | None) -> None:
        # The last slices are still to be written when they are done.
        fraction = done / (self._slices + 1)
        rounded = None if left is None else round(left, 1)
        self._report(Progress(fraction=fraction, stage="reconstruct", seconds_left=rounded))
