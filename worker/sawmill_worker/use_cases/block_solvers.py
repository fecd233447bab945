"""A method at work on a log: how blocks of slices go through it, and its report."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from threading import Lock
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.reconstructions import MethodReport, ReconstructionOptions
from sawmill_worker.tomography import cost
from sawmill_worker.tomography.air import find_air
from sawmill_worker.tomography.choosing import Recommendation
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.progress import OnProgress, Phases
from sawmill_worker.tomography.method import CANDIDATES_AT_ONCE, IMAGES_OF_A_DESCENT, DirectMethod, FittedMethod, Method
from sawmill_worker.tomography.methods import METHODS
from sawmill_worker.tomography.noise import data_misfit, estimated_noise
from sawmill_worker.tomography.present_rows import filled, present_rows
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.tomography.stack import most_concurrent
from sawmill_worker.use_cases.capacity import check_memory
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.metal_reduction import MetalReduction, WithoutMetal
from sawmill_worker.use_cases.method_findings import MethodFindings
from sawmill_worker.vocabulary import MetalHandling, ReconstructionMethod

Images = NDArray[np.float32]
Curve = Mapping[str, NDArray[np.float64]]

# Slices by a direct method whose misfit is computed: projecting a slice takes longer than reconstructing it
# (docs/performance.md).
CHECKED_SLICES = 5
# Slices that a fitted method reconstructs side by side: more are no faster (benchmarks/iterative.py).
FITTED_TOGETHER = 16
NO_UNCERTAINTY = (
    "uncertainty is ignored, and a later version will refuse it: no map was found that shows where the errors are "
    "(docs/reconstruction.md#the-uncertainty-map)"
)
# A background below this share of the noise is taken for none.
BACKGROUND = 0.5
# The most images that a fitted method has in memory at once.
MOST_FITTED_IMAGES = max(
    IMAGES_OF_A_DESCENT * max(CANDIDATES_AT_ONCE, FITTED_TOGETHER),
    *(method.least_images for method in METHODS.values() if issubclass(method, FittedMethod)),
)


@dataclass(frozen=True, eq=False)
class LogTask:
    """The log to reconstruct.

    Attributes
    ----------
    sample : (views, detector) float32
        The line integrals of the middle slice; those of views that lack it interpolated in angle.
    radius_mm : float
        Of the disc around the rotation centre that holds the log in every slice.
    slices : int
        Of the whole volume.
    middle_row : int
        The scan's row of the sample.
    counts : bool
        Whether the line integrals were made from counts, so that dark rays are noisier than bright ones.
    memory_bytes : int
        Limit of all blocks together.
    on_progress : callable
        Called, while a block is at work, with the number of its slices that the work done is worth.
    """

    options: ReconstructionOptions
    projector: Projector
    sample: Images
    radius_mm: float
    slices: int
    middle_row: int
    counts: bool
    memory_bytes: int
    on_progress: Callable[[float], None]

    def full_grid(self) -> tuple[ImageGrid, tuple[slice, slice]]:
        """The grid that also holds all of the log, and where the field lies in it."""
        return self.projector.grid.around(self.radius_mm)


class BlockSolver(Protocol):
    """A method at work on one log.

    Attributes
    ----------
    step, concurrent : int
        Slices in a block, and the number of threads that may call it at once.
    curve : mapping or None
        What the parameters of the middle slice were chosen from, or of the nearest slice that is not empty: columns,
        and the parameters taken.
    """

    step: int
    concurrent: int
    curve: Curve | None

    def __call__(self, first: int, rows: Images) -> Images:
        """Slices (slices, x, y) of line integrals (views, slices, detector); `first` is the number of the first slice.

        NaN in every cell of rows that a view lacks: methods that can leave out rays do without them, others have them
        interpolated in angle.
        """

    def report(self) -> MethodReport:
        """The report of the blocks so far."""


def may_fit(name: ReconstructionMethod) -> bool:
    """Whether the method, or one that `auto` may choose, is a fitted one."""
    kind = METHODS.get(name)
    return kind is None or issubclass(kind, FittedMethod)


def method_of(name: ReconstructionMethod, options: ReconstructionOptions) -> Method:
    """The method with those of the options that are its own."""
    kind = METHODS[name]
    return kind(**{option.name: getattr(options, option.name) for option in fields(kind)})


def solver_of(name: ReconstructionMethod, task: LogTask, recommended: Recommendation | None) -> BlockSolver:
    """The solver of a method.

    Parameters
    ----------
    recommended : Recommendation or None
        What `auto` chose the method by.

    Raises
    ------
    sawmill_worker.use_cases.failures.JobFailure
        One slice does not fit into the memory, or the slice to choose parameters from is empty.
    """
    method, findings = method_of(name, task.options), MethodFindings(name, recommended)
    if task.options.uncertainty:
        findings.remark(NO_UNCERTAINTY)
    if isinstance(method, DirectMethod):
        return _DirectSolver(method, task, findings)
    return _FittedSolver(name, method, task, findings)


class _DirectSolver:
    """Concurrent blocks of the field alone; the misfit of a few slices."""

    curve: Curve | None = None

    def __init__(self, method: DirectMethod, task: LogTask, findings: MethodFindings) -> None:
        views, cells = task.projector.geometry.sinogram_shape
        size = task.projector.grid.size
        check_memory(cost.block_bytes(views, cells, size, 1), task.memory_bytes)
        memory_bytes = min(cost.MEMORY_BYTES, task.memory_bytes)
        self.step, self.concurrent = cost.blocks(views, cells, size, task.slices, memory_bytes, most_concurrent())
        self._method, self._projector = method, task.projector
        self._metal = _metal_reduction(task, leave_out=False)
        self._findings, self._checking = findings, Lock()
        self._holds_all = task.full_grid()[0].size == size
        self._checked = set(np.linspace(0, task.slices - 1, CHECKED_SLICES).round().astype(int).tolist())

    def __call__(self, first: int, rows: Images) -> Images:
        complete = filled(rows, self._projector.geometry.angles_rad)
        block = self._metal(complete.transpose(1, 0, 2))
        images = self._method.reconstruct(self._projector, block.lines).image
        for index in range(rows.shape[1]):
            if first + index in self._checked:
                with self._checking:
                    self._check(block.lines[index], images[index])
        block.put_back(images, self._projector.grid)
        return images

    def _check(self, line: Images, image: Images) -> None:
        lines = np.ascontiguousarray(line)[None]
        noise = estimated_noise(lines[0])
        if _backgrounds(lines).any():
            self._findings.remark(
                "the air does not stand at 0, and that is in the slices: prepare the scan with air=background"
            )
        if not self._holds_all:
            self._findings.add_checked(noise)
            return
        misfit = data_misfit(self._projector, image[None], lines, np.full((1, 1, 1), noise))
        self._findings.add_checked(noise, misfit)
        remark = self._method.remark_on(float(misfit[0]), lines[0], noise)
        if remark is not None:
            self._findings.remark(remark)

    def report(self) -> MethodReport:
        return self._findings.report(self._metal.report())


class _FittedSolver:
    """One block after another, on a grid that holds all of the log, from line integrals whose air stands at 0.

    Parameters that are not given are chosen from the middle slice, and are the same along the log. An empty slice is an
    empty image: it has no scale to choose anything by.
    """

    concurrent = 1

    def __init__(
        self, name: ReconstructionMethod, method: FittedMethod, task: LogTask, findings: MethodFindings
    ) -> None:
        grid, self._field = task.full_grid()
        self._projector = Projector(task.projector.geometry, grid)
        self._method, self._task, self._findings = method, task, findings
        self.curve: Curve | None = None
        # Of the slice of the curve from the middle one, in slices.
        self._curve_distance: float = np.inf
        if grid.size != task.projector.grid.size:
            findings.remark(
                f"the whole log was reconstructed, {grid.field_mm:.0f} mm across, and the field cut out of it"
            )
        image_bytes = 4 * grid.size**2
        check_memory(method.least_images * image_bytes, task.memory_bytes)
        together = task.memory_bytes // (IMAGES_OF_A_DESCENT * image_bytes)
        self.step = int(min(max(together, 1), FITTED_TOGETHER))
        self._metal = _metal_reduction(task, leave_out=method.leaves_out)
        if method.is_open:
            self._sample = _levelled(task.sample[None], findings)
            if not self._sample.any():
                raise refused(
                    "empty-slice",
                    f"row {task.middle_row}, the middle one, from which {name} chooses its settings, shows nothing: "
                    "leave it out of the rows, or give the settings",
                )

    def __call__(self, first: int, rows: Images) -> Images:
        complete = filled(rows, self._projector.geometry.angles_rad)
        lines, lost = _levelled(np.ascontiguousarray(complete.transpose(1, 0, 2)), self._findings), ~present_rows(rows)
        shown = lines.any(axis=(1, 2))
        size = self._task.projector.grid.size
        images = np.zeros((len(lines), size, size), np.float32)
        if shown.any():
            numbers = first + np.flatnonzero(shown)
            block = self._metal(lines[shown])
            left_out = self._left_out(block, lost.T[shown])
            found = self._solve(
                numbers, block.lines, left_out, lambda share: self._task.on_progress(len(lines) * share)
            )
            block.put_back(found, self._projector.grid)
            field = (slice(None), *self._field)
            images[shown] = found[field]
        self._findings.add_empty(int((~shown).sum()))
        return images

    def _left_out(self, block: WithoutMetal, lost: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
        """The rays that the method does without: through metal, and of views that lost the row (slices, views)."""
        if not (self._method.leaves_out and lost.any()):
            return block.left_out
        rays = np.broadcast_to(lost[:, :, None], block.lines.shape)
        return rays if block.left_out is None else block.left_out | rays

    def _solve(
        self,
        numbers: NDArray[np.int64],
        lines: Images,
        left_out: NDArray[np.bool_] | None,
        on_progress: OnProgress,
    ) -> Images:
        """Slices of the full grid, from line integrals (slices, views, detector)."""
        method, counts = self._method, self._task.counts
        choosing = method.is_open and self._task.slices > len(lines)
        phases = Phases(on_progress, choose=method.choosing_cost_slices * choosing, reconstruct=len(lines))
        if choosing:
            sample = self._metal.taken_out(self._sample)
            method = self._method = method.chosen(
                self._projector,
                sample.lines[0],
                counts=counts,
                on_progress=phases.of("choose"),
                left_out=sample.left_out,
            )
        found = method.reconstruct(
            self._projector,
            lines,
            counts=counts,
            on_progress=phases.of("reconstruct"),
            left_out=left_out,
        )
        self._findings.add(found)
        if found.curves:
            self._keep_nearest_curve(numbers, found.curves, found.parameters)
        return found.image

    def _keep_nearest_curve(
        self, numbers: NDArray[np.int64], curves: tuple[Curve, ...], parameters: Mapping[str, NDArray[np.float64]]
    ) -> None:
        distances = np.abs(numbers - self._task.slices // 2)
        index = int(np.argmin(distances))
        if distances[index] < self._curve_distance:
            self._curve_distance = int(distances[index])
            self.curve = {**curves[index], **{name: np.array(values[index]) for name, values in parameters.items()}}

    def report(self) -> MethodReport:
        return self._findings.report(self._metal.report())


def _metal_reduction(task: LogTask, *, leave_out: bool) -> MetalReduction:
    asked = task.options.metal
    return MetalReduction(
        task.projector.geometry,
        task.radius_mm,
        leave_out=leave_out and asked is MetalHandling.AUTO,
        wanted=asked is not MetalHandling.NONE,
    )


def _levelled(lines: Images, findings: MethodFindings) -> Images:
    """Line integrals (slices, views, detector) without the background that their air shows."""
    backgrounds = _backgrounds(lines)
    if not backgrounds.any():
        return lines
    findings.remark("the air did not stand at 0: a background was taken out of the data")
    return lines - backgrounds[:, None, None]


def _backgrounds(lines: Images) -> NDArray[np.float32]:
    """The level of the air of each slice; 0 where it is small beside the noise or no air is seen."""
    backgrounds = np.zeros(len(lines), np.float32)
    for index, line in enumerate(lines):
        air = find_air(line)
        if air is not None and abs(air.background) > BACKGROUND * air.noise:
            backgrounds[index] = air.background
    return backgrounds
