"""Findings of a method, block by block: metal that is removed before a block is solved and put back, and the report."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.reconstructions import MetalReport, MethodReport
from sawmill_tomography.geometry.geometry import FanViews
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.choosing import Recommendation
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.metal import INTERPOLATION, MOST_SAMPLES, WITHOUT_RAYS, LogMetal, MetalSearch
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.image_messages import ImageMessage


@dataclass
class MetalCount:
    """Number of slices with metal, of line integrals through metal and of all in them, and of slices used as is."""

    slices: int = 0
    samples: int = 0
    all_samples: int = 0
    untreated_slices: int = 0


@dataclass
class CurvePoints:
    """Data from which the parameters of a slice near the middle were chosen: columns, and the chosen parameters."""

    slices_from_middle: int
    columns: dict[str, list[float] | float]


@dataclass
class BlockFindings:
    """Findings of a method in a block of slices; JSON-able by `dataclasses.asdict`."""

    noise: list[float] = field(default_factory=list)
    misfit: list[float] = field(default_factory=list)
    parameters: dict[str, list[float]] = field(default_factory=dict)
    unconverged: int = 0
    remarks: list[str] = field(default_factory=list)
    metal: MetalCount = field(default_factory=MetalCount)
    curve: CurvePoints | None = None

    def remark(self, sentence: str) -> None:
        """Add a remark if it is new."""
        if sentence not in self.remarks:
            self.remarks.append(sentence)

    def add(self, estimate: Estimate) -> None:
        """Add an estimate's quality and the parameters of the slices."""
        if estimate.noise is not None:
            self.noise.append(float(estimate.noise))
        if estimate.misfit is not None:
            self.misfit.extend(estimate.misfit.tolist())
        self.unconverged += int((~estimate.converged).sum())
        for sentence in estimate.remarks:
            self.remark(sentence)
        for name, values in estimate.parameters.items():
            self.parameters.setdefault(name, []).extend(values.tolist())

    def add_checked(self, noise: float, misfit: NDArray[np.float64] | None = None) -> None:
        """Add the quality of a slice that was checked after the reconstruction."""
        self.noise.append(float(noise))
        if misfit is not None:
            self.misfit.extend(misfit.tolist())


def gathered(blocks: Iterable[BlockFindings]) -> BlockFindings:
    """Merge the findings of all blocks; of the curves, keep the curve nearest to the middle."""
    every = BlockFindings()
    for block in blocks:
        every.noise += block.noise
        every.misfit += block.misfit
        every.unconverged += block.unconverged
        for sentence in block.remarks:
            every.remark(sentence)
        for name, values in block.parameters.items():
            every.parameters.setdefault(name, []).extend(values)
        every.metal.slices += block.metal.slices
        every.metal.samples += block.metal.samples
        every.metal.all_samples += block.metal.all_samples
        every.metal.untreated_slices += block.metal.untreated_slices
        nearest = every.curve is None or (
            block.curve is not None and block.curve.slices_from_middle < every.curve.slices_from_middle
        )
        every.curve = block.curve if nearest else every.curve
    return every


def report_of(
    method: ReconstructionMethod, recommended: Recommendation | None, findings: BlockFindings, metal: MetalReport | None
) -> MethodReport:
    """Summarise the findings: medians over the slices, the worst misfit, and the metal."""
    if metal is not None and metal.untreated_slices:
        findings.remark(ImageMessage.METAL_LEFT(percent=100.0 * MOST_SAMPLES, slices=metal.untreated_slices))
    return MethodReport(
        name=method,
        reason=None if recommended is None else recommended.reason,
        expected_error=None if recommended is None else recommended.expected_error,
        view_step=1 if recommended is None else recommended.view_step,
        noise=float(np.median(findings.noise)) if findings.noise else 0.0,
        data_misfit=float(np.median(findings.misfit)) if findings.misfit else None,
        worst_data_misfit=max(findings.misfit) if findings.misfit else None,
        metal=metal,
        unconverged_slices=findings.unconverged,
        remarks=findings.remarks,
        coded_remarks=[CodedReason.of(each) for each in findings.remarks],
        **{name: float(np.median(values)) for name, values in findings.parameters.items()},
    )


Images = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class WithoutMetal:
    """A block (slices, views, detector) whose rays through metal are interpolated, or less the metal.

    Metal is by the slice's index; the uncertainty of rays through it is infinite for rays to be left out.
    """

    lines: Images
    metal: Mapping[int, LogMetal] = field(default_factory=dict)
    untreated: frozenset[int] = frozenset()
    uncertainty: Images | None = None

    def count(self, selected: NDArray[np.bool_] | None = None) -> MetalCount:
        """Count the metal in the block, or in the slices of the mask `selected` (slices,)."""
        traces = [metal.trace for index, metal in self.metal.items() if selected is None or selected[index]]
        return MetalCount(
            len(traces),
            sum(int(trace.sum()) for trace in traces),
            sum(trace.size for trace in traces),
            sum(selected is None or bool(selected[index]) for index in self.untreated),
        )

    def put_back(self, images: Images, grid: ImageGrid) -> None:
        """Add the metal to images (slices, size, size), in place."""
        for index, metal in self.metal.items():
            images[index] += metal.body.on(grid)


class MetalReduction:
    """Reduction of metal in the blocks of a log: rays are interpolated, left out, or weighed where metal is thin."""

    def __init__(self, geometry: FanViews, radius_mm: float, *, leave_out: bool, weigh: bool, enabled: bool) -> None:
        self._search = MetalSearch.of(geometry, radius_mm) if enabled else None
        self._leave_out, self._weigh, self._working = leave_out, weigh, Lock()

    def __call__(self, lines: Images) -> WithoutMetal:
        """Return a block (slices, views, detector) of any strides without its metal."""
        if self._search is None:
            return WithoutMetal(lines)
        with self._working:
            searched = dict(enumerate(self._search.find(np.ascontiguousarray(lines))))
        metals = {index: metal for index, metal in searched.items() if metal is not None and not metal.is_too_much}
        untreated = frozenset(index for index, metal in searched.items() if metal is not None and metal.is_too_much)
        if not metals:
            return WithoutMetal(lines, untreated=untreated)
        without, uncertainty = lines.copy(), np.zeros(lines.shape, np.float32)
        for index, metal in metals.items():
            without[index] = metal.freed if self._weigh else metal.filled
            uncertainty[index] = metal.uncertainty if self._weigh else np.where(metal.trace, math.inf, 0.0)
        return WithoutMetal(without, metals, untreated, uncertainty if self._leave_out else None)

    def report(self, count: MetalCount) -> MetalReport | None:
        """Return the report of the counted metal; None if there is none."""
        if not (count.slices or count.untreated_slices):
            return None
        return MetalReport(
            slices=count.slices,
            samples=count.samples,
            share_of_samples=count.samples / max(count.all_samples, 1),
            untreated_slices=count.untreated_slices,
            treatment="left-out" if self._leave_out else "interpolated",
            source=WITHOUT_RAYS if self._leave_out else INTERPOLATION,
        )
