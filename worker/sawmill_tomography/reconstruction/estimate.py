"""The result of every reconstruction method."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """A reconstruction of one slice or of a block, and how it was made."""

    image: Image  # (size, size) or (slices, size, size) float32: [x, y], in the sinogram's unit per mm
    iterations: NDArray[np.int64]  # (slices,) int64: number of iterations; 0 for a direct method
    converged: NDArray[np.bool_]  # (slices,) bool: True if the tolerance was reached before the iterations ran out
    # Values that the method used, given or chosen, by the names of its options; one value may serve all slices
    parameters: Mapping[str, Floats] = field(default_factory=dict)
    noise: float | None = None  # root mean square of the standard deviation of the data, given or estimated
    # (slices,): residual: root mean square of (A x - y) / noise. It is near 1 if geometry and noise are right, far
    # above if not. A direct method does not compute it.
    misfit: Floats | None = None
    # (slices,): minimised objective, at the image; for coupled slices the sum over all of them
    objective: Floats | None = None
    # One curve a slice, from which its parameters were chosen, by column; empty where the method has none
    curves: tuple[Mapping[str, Floats], ...] = ()
    remarks: tuple[str, ...] = ()  # remarks on the data and the fit for the user

    def part(self, which: NDArray[np.bool_]) -> "Estimate":
        """Select slices of a block by a mask (slices,)."""
        slices = len(self.converged)
        return replace(
            self,
            image=self.image[which],
            iterations=self.iterations[which],
            converged=self.converged[which],
            parameters={name: of[which] if of.size == slices else of for name, of in self.parameters.items()},
            misfit=None if self.misfit is None else self.misfit[which],
            objective=None if self.objective is None else self.objective[which],
            curves=tuple(curve for curve, selected in zip(self.curves, which, strict=False) if selected),
        )

    @classmethod
    def direct(cls, image: Image) -> "Estimate":
        """Return the estimate of a method without iterations or parameters."""
        slices = 1 if image.ndim == 2 else len(image)
        return cls(image, np.zeros(slices, np.int64), np.ones(slices, bool))
