"""What a reconstruction's method tells of itself, gathered over the blocks of a log."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.reconstructions import MethodReport
from sawmill_worker.vocabulary import ReconstructionMethod

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Slices:
    """Slices (slices, x, y) float32 and, where asked for, each pixel's standard deviation."""

    images: NDArray[np.float32]
    deviation: NDArray[np.float32] | None = None


class Solved(Protocol):
    """What every iterative method tells of a block."""

    @property
    def noise(self) -> float:
        """Root mean square of the data's noise."""

    @property
    def misfit(self) -> Floats:
        """Of each slice, against the noise."""

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Of each slice."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """For the user."""


class MethodFindings:
    """Gathers what each block told, and makes the report of it."""

    def __init__(self, method: ReconstructionMethod, reason: str | None) -> None:
        self.noise: list[float] = []
        self.misfit: list[float] = []
        self._method, self._reason = method, reason
        self._parameters: dict[str, list[float]] = {}
        self._unconverged = 0
        self._remarks: dict[str, None] = {}

    def remark(self, sentence: str) -> None:
        """Tell it once."""
        self._remarks.setdefault(sentence)

    def add(self, solved: Solved, **parameters: Floats) -> None:
        """Take in a block: its quality, and the parameters that its slices took."""
        self.noise.append(solved.noise)
        self.misfit.extend(solved.misfit.tolist())
        self._unconverged += int((~solved.converged).sum())
        for sentence in solved.remarks:
            self.remark(sentence)
        for name, values in parameters.items():
            self._parameters.setdefault(name, []).extend(values.tolist())

    def add_empty(self, slices: int) -> None:
        """Take in slices whose image and data are both 0: they miss nothing."""
        self.misfit.extend([0.0] * slices)

    def report(self) -> MethodReport:
        """Medians over the slices, and the worst misfit."""
        return MethodReport(
            name=self._method,
            reason=self._reason,
            noise=float(np.median(self.noise)) if self.noise else 0.0,
            data_misfit=float(np.median(self.misfit)) if self.misfit else None,
            worst_data_misfit=max(self.misfit) if self.misfit else None,
            unconverged_slices=self._unconverged,
            remarks=list(self._remarks),
            **{name: float(np.median(values)) for name, values in self._parameters.items()},
        )
