"""Findings of a reconstruction method, block by block, and the report of the findings."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.reconstructions import MetalReport, MethodReport
from sawmill_tomography.reconstruction.choosing import Recommendation
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.metal import MOST_SAMPLES
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.image_messages import ImageMessage


@dataclass
class MetalCount:
    """Number of slices with metal, of its line integrals and of all in them, and of slices used as they are."""

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
        """Add an estimate's quality and the parameters of its slices."""
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

    def add_empty(self, slices: int) -> None:
        """Add slices whose image and data are both 0, with misfit 0."""
        self.misfit.extend([0.0] * slices)


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
