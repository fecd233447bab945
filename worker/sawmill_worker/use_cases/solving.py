"""One method with its options, for a block of slices at a time, and what it found out on the way."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.reconstructions import MethodReport, ReconstructionOptions
from sawmill_worker.tomography import cost
from sawmill_worker.tomography.air import find_air
from sawmill_worker.tomography.cauchy_map import Choice, cauchy_map, choose
from sawmill_worker.tomography.fbp import Block, fbp_block
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.iterative.telling import Phases, Told
from sawmill_worker.tomography.noise import data_misfit, estimated_noise, photon_noise, remark_on_filtered
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.tomography.stack import most_abreast
from sawmill_worker.tomography.tikhonov import AlphaCurve, tikhonov
from sawmill_worker.tomography.total_variation import choose_weight, total_variation
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.method_findings import MethodFindings, Slices
from sawmill_worker.use_cases.room import check_memory
from sawmill_worker.vocabulary import ReconstructionMethod

Columns = Mapping[str, NDArray[np.float64]]
Sinogram = NDArray[np.float32]
Indices = NDArray[np.int64]

# Slices by `fbp` whose misfit is looked at: projecting one takes longer than reconstructing it.
FBP_SLICES_LOOKED_AT = 5
# Slices that iterate side by side: more bring nothing.
ITERATED_TOGETHER = 16
# Images that a descent keeps for each slice, trials side by side, and Tikhonov's basis.
IMAGES_A_DESCENT, TRIALS, IMAGES_OF_A_BASIS = 24, 10, 100
# A background below this share of the noise is none.
BACKGROUND = 0.5


@dataclass(frozen=True, eq=False)
class Work:
    """What there is to reconstruct.

    Attributes
    ----------
    sample : (views, detector) float32
        The line integrals of the middle slice.
    radius_mm : float
        Of the disc around the rotation centre that holds all that was scanned, in every slice.
    slices : int
        Of the whole volume.
    middle_row : int
        The scan's row that the sample is.
    counts : bool
        Whether the line integrals were made from counts, so that dark rays are noisier than bright ones.
    memory_bytes : int
        What may be used.
    reason : str or None
        Why `auto` chose the method.
    told : callable
        Told, while a block is at work, how many of its slices' worth is done.
    """

    options: ReconstructionOptions
    projector: Projector
    sample: Sinogram
    radius_mm: float
    slices: int
    middle_row: int
    counts: bool
    memory_bytes: int
    reason: str | None
    told: Callable[[float], None]

    @property
    def whole(self) -> tuple[ImageGrid, tuple[slice, slice]]:
        """The grid that also holds all that was scanned, and where the field lies in it."""
        return self.projector.grid.around(self.radius_mm)


class Solver(Protocol):
    """A method at work on one scan.

    Attributes
    ----------
    step, abreast : int
        Slices that it takes at a time, and how many threads may call it at once.
    curve : mapping or None
        What Tikhonov's alpha was chosen from in the middle slice, or the nearest to it that shows anything, a column
        each, and the `alpha` taken.
    """

    step: int
    abreast: int
    curve: Columns | None

    def __call__(self, first: int, rows: Block) -> Slices:
        """Line integrals (views, slices, detector) to slices, the first of which is so many from the log's first."""

    def report(self) -> MethodReport:
        """What was done so far."""


def solver_of(method: ReconstructionMethod, work: Work) -> Solver:
    """The method, refused where one slice does not fit into the memory."""
    makers: dict[ReconstructionMethod, Callable[[Work], Solver]] = {
        ReconstructionMethod.FBP: _Fbp,
        ReconstructionMethod.TIKHONOV: _Tikhonov,
        ReconstructionMethod.CAUCHY_MAP: _CauchyMap,
        ReconstructionMethod.TOTAL_VARIATION: _TotalVariation,
    }
    return makers[method](work)


class _Fbp:
    def __init__(self, work: Work) -> None:
        views, cells = work.projector.geometry.sinogram_shape
        size = work.projector.grid.size
        check_memory(cost.block_bytes(views, cells, size, 1), work.memory_bytes)
        memory_bytes = min(cost.MEMORY_BYTES, work.memory_bytes)
        self.step, self.abreast = cost.blocks(views, cells, size, work.slices, memory_bytes, most_abreast())
        self.curve: Columns | None = None
        self._work = work
        self._findings, self._looking = MethodFindings(ReconstructionMethod.FBP, work.reason), Lock()
        self._holds_all = work.whole[0].size == size
        self._looked_at = set(np.linspace(0, work.slices - 1, FBP_SLICES_LOOKED_AT).round().astype(int).tolist())

    def __call__(self, first: int, rows: Block) -> Slices:
        options = self._work.options
        images = fbp_block(
            self._work.projector,
            rows,
            filter_name=options.filter,
            frequency_scaling=options.frequency_scaling,
            weighting=options.weighting,
        )
        for index in range(rows.shape[1]):
            if first + index in self._looked_at:
                with self._looking:
                    self._look_at(rows[:, index], images[index])
        return Slices(images)

    def _look_at(self, line: Sinogram, image: NDArray[np.float32]) -> None:
        lines = np.ascontiguousarray(line)[None]
        noise = estimated_noise(lines[0])
        if _backgrounds(lines).any():
            self._findings.remark(
                "the air does not stand at 0, and that is in the slices: prepare the scan with air=background"
            )
        self._findings.noise.append(noise)
        if self._holds_all:
            misfit = data_misfit(self._work.projector, image[None], lines, np.full((1, 1, 1), noise))
            self._findings.misfit.extend(misfit.tolist())
            remark = remark_on_filtered(float(misfit[0]), lines[0], noise)
            if remark is not None:
                self._findings.remark(remark)

    def report(self) -> MethodReport:
        return self._findings.report()


class _Iterative(ABC):
    """These methods explain the measured rays, so they have pixels wherever there is wood, beyond the field too.

    A slice without any attenuation is empty without being solved: it has no scale to choose anything by.
    """

    method: ReconstructionMethod
    abreast = 1

    def __init__(self, work: Work) -> None:
        grid, self._part = work.whole
        self._projector = Projector(work.projector.geometry, grid)
        self._work = work
        self.curve: Columns | None = None
        self._findings = MethodFindings(self.method, work.reason)
        if grid.size != work.projector.grid.size:
            self._findings.remark(
                f"all that was scanned was reconstructed, {grid.field_mm:.0f} mm across, and the field cut out of it"
            )
        image_bytes = 4 * grid.size**2
        check_memory(self.images_at_once * image_bytes, work.memory_bytes)
        together = work.memory_bytes // (IMAGES_A_DESCENT * image_bytes)
        self.step = int(min(max(together, 1), ITERATED_TOGETHER))

    @property
    @abstractmethod
    def images_at_once(self) -> int:
        """The least that are in memory."""

    @abstractmethod
    def solve(self, numbers: Indices, lines: Block, progress: Told) -> Slices:
        """Line integrals (slices, views, detector), their air at 0, to slices of the larger field.

        None of them is empty; the numbers (slices,) count from the log's first.
        """

    def __call__(self, first: int, rows: Block) -> Slices:
        lines = _levelled(np.ascontiguousarray(rows.transpose(1, 0, 2)), self._findings)
        shown = lines.any(axis=(1, 2))
        size = self._work.projector.grid.size
        images = np.zeros((len(lines), size, size), np.float32)
        deviation = np.zeros_like(images) if self._work.options.uncertainty else None
        if shown.any():
            numbers = first + np.flatnonzero(shown)
            solved = self.solve(numbers, lines[shown], lambda share: self._work.told(len(lines) * share))
            inside = (slice(None), *self._part)
            images[shown] = solved.images[inside]
            if deviation is not None and solved.deviation is not None:
                deviation[shown] = solved.deviation[inside]
        self._findings.add_empty(int((~shown).sum()))
        return Slices(images, deviation)

    def report(self) -> MethodReport:
        return self._findings.report()


class _Tikhonov(_Iterative):
    method = ReconstructionMethod.TIKHONOV
    images_at_once = IMAGES_OF_A_BASIS
    # Of the slice whose curve is kept from the middle one, in slices.
    _distance: float = np.inf

    def solve(self, numbers: Indices, lines: Block, progress: Told) -> Slices:
        options = self._work.options
        found = tikhonov(self._projector, lines, alpha=options.alpha, rule=options.alpha_rule, progress=progress)
        self._findings.add(found, alpha=found.alpha)
        distances = np.abs(numbers - self._work.slices // 2)
        index = int(np.argmin(distances))
        if distances[index] < self._distance:
            self._distance = int(distances[index])
            self.curve = _columns(found.curves[index], found.alpha[index])
        return Slices(found.image)


class _Penalised(_Iterative):
    """What is chosen without being told is chosen in the middle slice, and the same along the log."""

    images_at_once = IMAGES_A_DESCENT * TRIALS
    # What choosing costs, in slices of a block.
    choosing_slices: float
    _chosen = False

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        if self.open and not self._sample.any():
            raise refused(
                "empty-slice",
                f"row {work.middle_row}, the middle one, from which {self.method} chooses its settings, shows nothing: "
                "leave it out of the rows, or give the settings",
            )

    @cached_property
    def _sample(self) -> Block:
        return _levelled(self._work.sample[None], self._findings)

    @abstractmethod
    def choose(self, line: Block, progress: Told) -> None:
        """Take the parameters for all slices from one of them (1, views, detector)."""

    def solve(self, _numbers: Indices, lines: Block, progress: Told) -> Slices:
        choosing = self.open and not self._chosen and self._work.slices > len(lines)
        phases = Phases(progress, choose=self.choosing_slices * choosing, descend=len(lines))
        if choosing:
            self.choose(self._sample, phases.of("choose"))
            self._chosen = True
        return self.descend(lines, phases.of("descend"))

    @property
    @abstractmethod
    def open(self) -> bool:
        """Whether parameters were left to be chosen."""

    @abstractmethod
    def descend(self, lines: Block, progress: Told) -> Slices:
        """To slices, with the parameters where they are chosen already."""

    def noise(self, lines: Block) -> NDArray[np.float64]:
        """Of each ray where they were counted, else of each slice."""
        air = np.array([estimated_noise(line) for line in lines]).reshape(-1, 1, 1)
        # Whatever a count is worth, the air tells how many make its noise.
        return photon_noise(lines, 1.0 / air**2) if self._work.counts else air


class _CauchyMap(_Penalised):
    method = ReconstructionMethod.CAUCHY_MAP
    choosing_slices = 16.0
    _choice: Choice | None = None

    @property
    def open(self) -> bool:
        return self._work.options.sigma is None and self._work.options.preset is None

    def choose(self, line: Block, progress: Told) -> None:
        options = self._work.options
        self._choice = choose(
            self._projector,
            line[0],
            beta=options.beta,
            noise=self.noise(line),
            non_negative=options.non_negative,
            progress=progress,
        )

    def descend(self, lines: Block, progress: Told) -> Slices:
        options, noise, choice = self._work.options, self.noise(lines), self._choice
        found = cauchy_map(
            self._projector,
            lines,
            sigma=options.sigma if choice is None else choice.factor * noise,
            beta=options.beta if choice is None else choice.beta,
            noise=noise,
            preset=options.preset,
            non_negative=options.non_negative,
            uncertainty=options.uncertainty,
            progress=progress,
        )
        self._findings.add(found, beta=found.beta, sigma=np.array([found.sigma]))
        return Slices(found.image, found.deviation)


class _TotalVariation(_Penalised):
    method = ReconstructionMethod.TOTAL_VARIATION
    choosing_slices = 5.0
    _weight: float | None = None

    @property
    def open(self) -> bool:
        return self._work.options.weight is None

    def choose(self, line: Block, progress: Told) -> None:
        self._weight = choose_weight(
            self._projector,
            line[0],
            noise=self.noise(line),
            non_negative=self._work.options.non_negative,
            progress=progress,
        ).weight

    def descend(self, lines: Block, progress: Told) -> Slices:
        options = self._work.options
        found = total_variation(
            self._projector,
            lines,
            weight=options.weight if self._weight is None else self._weight,
            noise=self.noise(lines),
            non_negative=options.non_negative,
            progress=progress,
        )
        self._findings.add(found, weight=found.weight)
        return Slices(found.image)


def _levelled(lines: Block, findings: MethodFindings) -> Block:
    """Line integrals (slices, views, detector) whose air stands at 0, where there is air to tell."""
    backgrounds = _backgrounds(lines)
    if not backgrounds.any():
        return lines
    findings.remark("the air did not stand at 0: a background was taken out of the data")
    return lines - backgrounds[:, None, None]


def _backgrounds(lines: Block) -> NDArray[np.float32]:
    """What the air of each slice stands at, 0 where that is nothing beside its noise or no air is seen."""
    backgrounds = np.zeros(len(lines), np.float32)
    for index, line in enumerate(lines):
        air = find_air(line)
        if air is not None and abs(air.background) > BACKGROUND * air.noise:
            backgrounds[index] = air.background
    return backgrounds


def _columns(curve: AlphaCurve, alpha: float) -> Columns:
    columns = {
        "alphas": curve.alphas,
        "residual_norms": curve.residual_norms,
        "solution_norms": curve.solution_norms,
        "alpha": np.array(alpha),
    }
    return columns if curve.gcv is None else {**columns, "gcv": curve.gcv}
