"""The findings of a reconstruction's method, gathered over the blocks of a log."""

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.reconstructions import MetalReport, MethodReport
from sawmill_worker.tomography.choosing import Recommendation
from sawmill_worker.tomography.estimate import Estimate
from sawmill_worker.vocabulary import ReconstructionMethod


class MethodFindings:
    """Gathers the findings of each block for the method's report."""

    def __init__(self, method: ReconstructionMethod, recommended: Recommendation | None) -> None:
        self._method, self._recommended = method, recommended
        self._noise: list[float] = []
        self._misfit: list[float] = []
        self._parameters: dict[str, list[float]] = {}
        self._unconverged = 0
        self._remarks: dict[str, None] = {}

    def remark(self, sentence: str) -> None:
        """Add a remark, once."""
        self._remarks.setdefault(sentence)

    def add(self, found: Estimate) -> None:
        """Add a block: its quality, and the parameters of its slices."""
        if found.noise is not None:
            self._noise.append(found.noise)
        if found.misfit is not None:
            self._misfit.extend(found.misfit.tolist())
        self._unconverged += int((~found.converged).sum())
        for sentence in found.remarks:
            self.remark(sentence)
        for name, values in found.parameters.items():
            self._parameters.setdefault(name, []).extend(values.tolist())

    def add_checked(self, noise: float, misfit: NDArray[np.float64] | None = None) -> None:
        """Add the quality of a slice that was checked after its reconstruction."""
        self._noise.append(noise)
        if misfit is not None:
            self._misfit.extend(misfit.tolist())

    def add_empty(self, slices: int) -> None:
        """Add slices whose image and data are both 0: their misfit is 0."""
        self._misfit.extend([0.0] * slices)

    def report(self, metal: MetalReport | None) -> MethodReport:
        """Medians over the slices, the worst misfit, and the metal that was found."""
        chosen = self._recommended
        return MethodReport(
            name=self._method,
            reason=None if chosen is None else chosen.reason,
            expected_error=None if chosen is None else chosen.expected_error,
            view_step=1 if chosen is None else chosen.view_step,
            noise=float(np.median(self._noise)) if self._noise else 0.0,
            data_misfit=float(np.median(self._misfit)) if self._misfit else None,
            worst_data_misfit=max(self._misfit) if self._misfit else None,
            metal=metal,
            unconverged_slices=self._unconverged,
            remarks=list(self._remarks),
            **{name: float(np.median(values)) for name, values in self._parameters.items()},
        )
