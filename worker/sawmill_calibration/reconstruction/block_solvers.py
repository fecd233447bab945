"""Reconstruction methods applied to a log block by block, and the report of the method."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from threading import Lock
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.failures import check_memory, refused
from sawmill_calibration.reconstruction.method_findings import (
    BlockFindings,
    CurvePoints,
    MetalReduction,
    WithoutMetal,
    gathered,
    report_of,
)
from sawmill_contracts.reconstructions import MetalReport, MethodReport, ReconstructionOptions
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.choosing import METHODS, Recommendation
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.iterative.coarse_outside import CoarseOutside, TwoGrids
from sawmill_tomography.reconstruction.iterative.progress import OnProgress, Phases
from sawmill_tomography.reconstruction.knot_contrast import knot_contrasts
from sawmill_tomography.reconstruction.method import (
    CANDIDATES_AT_ONCE,
    IMAGES_OF_A_DESCENT,
    DirectMethod,
    FittedMethod,
    Method,
)
from sawmill_tomography.reconstruction.stack import most_concurrent
from sawmill_tomography.reconstruction.total_variation import TotalVariation
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.noise import data_misfit, estimated_noise, noise_of_rays
from sawmill_tomography.sinograms.present_rows import filled, present_rows
from sawmill_vocabulary import MetalHandling, ReconstructionMethod
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.scattered_radiation import BeamCorrection

Images = NDArray[np.float32]
WHOLE = slice(None)
# JSON-able.
Settings = Mapping[str, Any]
Report = Callable[[BlockFindings, MetalReport | None], MethodReport]

# Number of slices by a direct method whose misfit is computed: projecting a slice takes longer than reconstructing it.
CHECKED_SLICES = 5
# Number of slices that a fitted method reconstructs together: more are no faster (benchmarks/iterative.py at 3ab7f653).
FITTED_TOGETHER = 16
# Number of slices that are coupled, including the neighbours of the block.
COUPLED_TOGETHER = 32
MOST_TOGETHER = max(FITTED_TOGETHER, COUPLED_TOGETHER)
NO_UNCERTAINTY = (
    "uncertainty is ignored, and a later version will refuse it: no map was found that shows where the errors are "
    "(docs/understand/reconstruction.md#the-uncertainty-map)"
)
# A knot of 10 mm that keeps less than this share of its contrast is worth a remark.
FADED = 0.9
# A background below this share of the noise is treated as 0.
BACKGROUND = 0.5
# Largest number of images that a fitted method has in memory at once.
MOST_FITTED_IMAGES = max(
    IMAGES_OF_A_DESCENT * max(CANDIDATES_AT_ONCE, MOST_TOGETHER),
    *(method.least_images for method in METHODS.values() if issubclass(method, FittedMethod)),
)


@dataclass(frozen=True, eq=False)
class LogTask:
    """The log to reconstruct.

    The sample is the middle slice, of `middle_row`, (views, detector) float32, and `around` returns the numbers and
    lines (slices, views, detector) of its neighbours; missing views are interpolated in angle. The disc of `radius_mm`
    around the rotation centre holds the log in every slice. `on_progress` takes the work done in a block, in slices.
    """

    options: ReconstructionOptions
    projector: Projector
    sample: Images
    radius_mm: float
    slices: int
    middle_row: int
    counts: bool
    beam: BeamCorrection
    memory_bytes: int
    on_progress: Callable[[float], None]
    on_chosen: Callable[[Settings], None]
    around: Callable[[], tuple[NDArray[np.int64], Images]]

    def full_grid(self) -> tuple[ImageGrid, tuple[slice, slice]]:
        """Return the grid that holds the field and the whole log, and the slices of the field in the grid."""
        return self.projector.grid.around(self.radius_mm)


class Solved(NamedTuple):
    """A solved block: its images (slices, x, y), and the findings."""

    images: Images
    findings: BlockFindings


class BlockSolver(Protocol):
    """A method for one log, which solves blocks of `step` slices, and `halo` at either end, in `concurrent` threads."""

    step: int
    concurrent: int
    halo: int

    @property
    def settings(self) -> Settings:
        """Settings chosen once for the whole log; a solver created with the same settings solves blocks identically."""

    def __call__(self, first: int, rows: Images, part: slice = WHOLE) -> Solved:
        """Solve the slices `part` of a block (views, slices, detector) from slice `first` on; lacking rows are NaN."""

    def report(self, findings: BlockFindings) -> MethodReport:
        """Return the report of the findings in all blocks."""


def may_fit(name: ReconstructionMethod) -> bool:
    """Return whether the method, or a method that `auto` may choose, is a fitted method."""
    kind = METHODS.get(name)
    return kind is None or issubclass(kind, FittedMethod)


def method_of(name: ReconstructionMethod, options: ReconstructionOptions) -> Method:
    """Return the method with the options that apply to it."""
    kind = METHODS[name]
    return kind(**{option.name: getattr(options, option.name) for option in fields(kind)})


def solver_of(
    name: ReconstructionMethod, task: LogTask, recommended: Recommendation | None, settings: Settings | None = None
) -> BlockSolver:
    """Create the solver of a method, with an earlier one's settings if given; refuse a slice too large or empty."""
    method, general = method_of(name, task.options), BlockFindings()
    if task.options.uncertainty:
        general.remark(NO_UNCERTAINTY)
    report = partial(report_of, name, recommended)
    if isinstance(method, DirectMethod):
        return _DirectSolver(method, task, general, report, settings)
    return _FittedSolver(name, method, task, general, report, settings)


class _DirectSolver:
    """Solver by a direct method: concurrent blocks of the field alone, and the misfit of a few slices."""

    halo = 0

    def __init__(
        self, method: DirectMethod, task: LogTask, general: BlockFindings, report: Report, settings: Settings | None
    ) -> None:
        views, cells = task.projector.geometry.sinogram_shape
        size = task.projector.grid.size
        check_memory(cost.block_bytes(views, cells, size, 1), task.memory_bytes)
        memory_bytes = min(cost.MEMORY_BYTES, task.memory_bytes)
        self.step, self.concurrent = cost.blocks(views, cells, size, task.slices, memory_bytes, most_concurrent())
        if settings is not None:
            self.step = settings["step"]
            fitting = memory_bytes // cost.block_bytes(views, cells, size, self.step)
            self.concurrent = max(1, min(self.concurrent, fitting))
        self._method, self._projector = method, task.projector
        self._metal = _metal_reduction(task)
        self._general, self._report, self._checking = general, report, Lock()
        self._holds_all = task.full_grid()[0].size == size
        self._checked = set(np.linspace(0, task.slices - 1, CHECKED_SLICES).round().astype(int).tolist())

    @property
    def settings(self) -> Settings:
        return {"step": self.step}

    def __call__(self, first: int, rows: Images, part: slice = WHOLE) -> Solved:  # noqa: ARG002 - slices are independent
        block = self._metal(filled(rows, self._projector.geometry.angles_rad).transpose(1, 0, 2))
        findings = BlockFindings(metal=block.count())
        images = self._method.reconstruct(self._projector, block.lines).image
        for index in range(rows.shape[1]):
            if first + index in self._checked:
                with self._checking:
                    self._check(block.lines[index], images[index], findings)
        block.put_back(images, self._projector.grid)
        return Solved(images, findings)

    def _check(self, line: Images, image: Images, findings: BlockFindings) -> None:
        lines = np.ascontiguousarray(line)[None]
        noise = estimated_noise(lines[0])
        if _backgrounds(lines).any():
            findings.remark(ImageMessage.AIR_IN_SLICES())
        if not self._holds_all:
            findings.add_checked(noise)
            return
        misfit = data_misfit(self._projector, image[None], lines, np.full((1, 1, 1), noise))
        findings.add_checked(noise, misfit)
        remark = self._method.remark_on(self._projector, image, float(misfit[0]), lines[0], noise)
        if remark is not None:
            findings.remark(remark)

    def report(self, findings: BlockFindings) -> MethodReport:
        return self._report(gathered([self._general, findings]), self._metal.report(findings.metal))


class _FittedSolver:
    """Solver by a fitted method: one block after another, on a grid that holds the whole log, with air levelled to 0.

    A field far smaller than the log has its own fine grid, fitted to the residual of the larger pixels outside it.
    Parameters that are not given are chosen from the middle slice for the whole log.
    """

    concurrent = 1

    def __init__(
        self,
        name: ReconstructionMethod,
        method: FittedMethod,
        task: LogTask,
        general: BlockFindings,
        report: Report,
        settings: Settings | None,
    ) -> None:
        self._method, self._task, self._general, self._report = method, task, general, report
        self._outside: CoarseOutside | None = None
        geometry, grids = task.projector.geometry, TwoGrids.of(task.projector.grid, task.radius_mm)
        if grids is None:
            grid, self._field = task.full_grid()
            if grid.size != task.projector.grid.size:
                general.remark(
                    f"the whole log was reconstructed, {grid.field_mm:.0f} mm across, and the field cut out of it"
                )
        else:
            grid, self._field = grids.region, grids.field
            self._outside = CoarseOutside.of(geometry, grids, non_negative=task.options.non_negative)
            general.remark(
                f"outside of the field the log was held at pixels of {grids.whole.pixel_mm:.3g} mm: what these miss is "
                "in the field's data misfit"
            )
        self._projector = Projector(geometry, grid)
        image_bytes = 4 * max(grid.size, 0 if grids is None else grids.whole.size) ** 2
        check_memory(method.least_images * image_bytes, task.memory_bytes)
        together = task.memory_bytes // (IMAGES_OF_A_DESCENT * image_bytes)
        self.halo = method.halo if isinstance(method, TotalVariation) and task.slices > 1 else 0
        self.step = int(max(min(together, COUPLED_TOGETHER if self.halo else FITTED_TOGETHER) - 2 * self.halo, 1))
        self._metal = _metal_reduction(task, leave_out=method.leaves_out, weigh=method.weighs)
        if method.is_open or self._outside is not None:
            self._sample = _levelled(task.sample[None], general)
            if not self._sample.any():
                cure = "leave it out of the rows" + (", or give the settings" if self._outside is None else "")
                raise refused(
                    "empty-slice",
                    f"row {task.middle_row}, the middle one, from which {name} chooses its settings, shows nothing: "
                    f"{cure}",
                )
        if settings is not None:
            self.step = settings["step"]
            self._choose(settings["choice"])
            if self._outside is not None:
                self._outside = replace(self._outside, weight=settings["outside_weight"])

    @property
    def settings(self) -> Settings:
        chosen = {"step": self.step, "choice": self._method.choice}
        return chosen if self._outside is None else {**chosen, "outside_weight": self._outside.weight}

    def _choose(self, choice: Mapping[str, float]) -> None:
        if choice:
            self._method = self._method.with_choice(choice)

    def __call__(self, first: int, rows: Images, part: slice = WHOLE) -> Solved:
        findings = BlockFindings()
        worth = len(range(rows.shape[1])[part])
        method = self._method
        couples = isinstance(method, TotalVariation) and method.coupling_is_open and self.halo > 0
        chooses = method.is_open and (couples or self._task.slices > worth)
        phases = Phases(
            lambda share: self._task.on_progress(worth * share),
            choose=method.choosing_cost_slices * chooses,
            couple=method.coupling_cost_slices * couples,
            reconstruct=worth,
        )
        if self._outside is not None and self._outside.weight is None:
            sample = self._metal(self._sample)
            self._outside = self._outside.chosen(sample.lines[0], self._noise(sample.lines, sample.uncertainty))
        if couples or chooses:
            self._choose_for_the_log(phases)
        if isinstance(self._method, TotalVariation) and not self._method.halo:
            # A slice whose coupling was chosen as 0 needs no neighbours.
            first, rows, part = first + (part.start or 0), rows[:, part], WHOLE
        complete = filled(rows, self._projector.geometry.angles_rad)
        lines, lost = _levelled(np.ascontiguousarray(complete.transpose(1, 0, 2)), findings), ~present_rows(rows)
        shown: NDArray[np.bool_] = np.asarray(lines.any(axis=(1, 2)))
        size = self._task.projector.grid.size
        images = np.zeros((len(lines), size, size), np.float32)
        if shown.any():
            numbers = first + np.flatnonzero(shown)
            block = self._metal(lines[shown])
            in_part = np.zeros(len(lines), bool)
            in_part[part] = True
            in_shown: NDArray[np.bool_] = in_part[shown]
            findings.metal = block.count(in_shown)
            uncertainty = self._uncertainty(block, lost.T[shown])
            estimate = self._solve(block.lines, uncertainty, numbers, phases.of("reconstruct"))
            findings.add(estimate.part(in_shown))
            findings.curve = self._curve_of(numbers, estimate)
            images_found = estimate.image
            block.put_back(images_found, self._projector.grid)
            images[shown] = images_found[(slice(None), *self._field)]
        findings.misfit += [0.0] * int((~shown[part]).sum())  # image and data are both 0
        return Solved(images[part], findings)

    def _uncertainty(self, block: WithoutMetal, lost: NDArray[np.bool_]) -> Images | None:
        """Return the rays' uncertainty by metal; infinite for `lost` views (slices, views) of a row."""
        if not (self._method.leaves_out and lost.any()):
            return block.uncertainty
        of_metal = np.zeros(block.lines.shape, np.float32) if block.uncertainty is None else block.uncertainty
        return np.where(lost[:, :, None], np.float32(math.inf), of_metal)

    def _choose_for_the_log(self, phases: Phases) -> None:
        """Choose the parameters from the sample, and the coupling of slices from the sample and its neighbours."""
        chosen = self._method
        if chosen.is_open:
            sample = self._metal(self._sample)
            noise = self._noise(sample.lines, sample.uncertainty)
            lines, _ = self._taken_out(sample.lines, noise)
            chosen = chosen.chosen(self._projector, lines[0], noise=noise, on_progress=phases.of("choose"))
        if isinstance(chosen, TotalVariation) and chosen.coupling_is_open:
            numbers, around = self._task.around()
            around = _levelled(around, self._general)
            shown = around.any(axis=(1, 2))
            block = self._metal(around[shown])
            noise = self._noise(block.lines, block.uncertainty)
            lines, _ = self._taken_out(block.lines, noise)
            chosen = chosen.with_coupling_chosen(
                self._projector,
                lines,
                numbers=numbers[shown],
                others_stay=not self._method.is_open or self._task.options.weight is not None,
                noise=noise,
                on_progress=phases.of("couple"),
            )
        self._choose(chosen.choice)
        self._task.on_chosen(self.settings)

    def _solve(
        self, lines: Images, uncertainty: Images | None, numbers: NDArray[np.int64], on_progress: OnProgress
    ) -> Estimate:
        """Reconstruct slices on the grid from line integrals (slices, views, detector)."""
        method = self._method
        noise = self._noise(lines, uncertainty)
        lines, below = self._taken_out(lines, noise)
        reconstruct = (
            partial(method.reconstruct, numbers=numbers) if isinstance(method, TotalVariation) else method.reconstruct
        )
        estimate = reconstruct(self._projector, lines, noise=noise, on_progress=on_progress)
        return estimate if below is None else replace(estimate, image=estimate.image + below)

    def _taken_out(self, lines: Images, noise: FloatArray) -> tuple[Images, Images | None]:
        """Return the lines (slices, views, detector) that the grid's pixels must explain, and images to add to them."""
        if self._outside is None:
            return lines, None
        return self._outside.taken_out(lines, noise, inside=self._method.shrinks)

    def _noise(self, lines: Images, uncertainty: Images | None) -> FloatArray:
        """Return the noise of the rays; uniform for a method that leaves out no rays."""
        if not self._method.leaves_out:
            return noise_of_rays(lines, counts=False, uncertainty=uncertainty)
        return noise_of_rays(lines, counts=self._task.counts, beam=self._task.beam, uncertainty=uncertainty)

    def _curve_of(self, numbers: NDArray[np.int64], estimate: Estimate) -> CurvePoints | None:
        """Return the curve of the slice nearest to the middle of the log."""
        if not estimate.curves:
            return None
        distances = np.abs(numbers - self._task.slices // 2)
        index = int(np.argmin(distances))
        columns = {name: column.tolist() for name, column in estimate.curves[index].items()}
        chosen = {name: float(values[index]) for name, values in estimate.parameters.items()}
        return CurvePoints(int(distances[index]), {**columns, **chosen})

    def report(self, findings: BlockFindings) -> MethodReport:
        merged = gathered([self._general, findings])
        if self._outside is None and isinstance(self._method, TotalVariation) and findings.misfit:
            self._find_knot_contrasts(self._method, merged)
        return self._report(merged, self._metal.report(findings.metal))

    def _find_knot_contrasts(self, method: TotalVariation, findings: BlockFindings) -> None:
        """Add the contrast that knots keep in the middle slice, and a remark where small knots fade."""
        sample = self._metal(_levelled(self._task.sample[None], self._general))
        if not sample.lines.any():
            return
        contrasts = knot_contrasts(
            self._projector,
            sample.lines[0],
            method.with_choice({name: float(np.median(values)) for name, values in findings.parameters.items()}),
            noise=self._noise(sample.lines, sample.uncertainty),
        )
        if contrasts is None:
            return
        ten, twenty = contrasts.values()
        findings.parameters.update(knot_10_mm_contrast=[ten], knot_20_mm_contrast=[twenty])
        if ten < FADED:
            findings.remark(
                ImageMessage.KNOTS_FADE(contrast_10_mm_percent=100.0 * ten, contrast_20_mm_percent=100.0 * twenty)
            )


def _metal_reduction(task: LogTask, *, leave_out: bool = False, weigh: bool = False) -> MetalReduction:
    handling = task.options.metal
    return MetalReduction(
        task.projector.geometry,
        task.radius_mm,
        leave_out=leave_out and handling is MetalHandling.AUTO,
        weigh=weigh and handling is MetalHandling.AUTO,
        enabled=handling is not MetalHandling.NONE,
    )


def _levelled(lines: Images, findings: BlockFindings) -> Images:
    """Subtract from line integrals (slices, views, detector) the background that their air shows."""
    backgrounds = _backgrounds(lines)
    if not backgrounds.any():
        return lines
    findings.remark("the air did not stand at 0: a background was taken out of the data")
    return lines - backgrounds[:, None, None]


def _backgrounds(lines: Images) -> NDArray[np.float32]:
    """Estimate the air level of each slice; 0 where the level is small compared with the noise or no air is seen."""
    backgrounds = np.zeros(len(lines), np.float32)
    for index, line in enumerate(lines):
        air = find_air(line)
        if air is not None and abs(air.background) > BACKGROUND * air.noise:
            backgrounds[index] = air.background
    return backgrounds
