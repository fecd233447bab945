"""The answer that every reconstruction method gives."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """A reconstruction of one slice or of a block, and what led to it.

    Attributes
    ----------
    image : (size, size) or (slices, size, size) float32
        [x, y], in the sinogram's unit per mm.
    iterations : (slices,) int64
        0 for a direct method.
    converged : (slices,) bool
        Whether the tolerance was reached before the iterations ran out.
    parameters : mapping of str to (slices,) or (1,) float64
        The values that the method took, given or chosen, by the names of its options; one value may serve all slices.
    noise : float, optional
        Root mean square of the standard deviation of the data, given or estimated.
    misfit : (slices,) float64, optional
        The residual: root mean square of (A x - y) / noise. Near 1 where geometry and noise are right, far above where
        not. A direct method does not compute it.
    objective : (slices,) float64, optional
        What the method minimised, at the image; of coupled slices that of all of them.
    curves : tuple of mapping of str to (points,) float64
        One a slice: what its parameters were chosen from, by column; empty where the method has none.
    remarks : tuple of str
        What a user should know of the data and the fit.
    """

    image: Image
    iterations: NDArray[np.int64]
    converged: NDArray[np.bool_]
    parameters: Mapping[str, Floats] = field(default_factory=dict)
    noise: float | None = None
    misfit: Floats | None = None
    objective: Floats | None = None
    curves: tuple[Mapping[str, Floats], ...] = ()
    remarks: tuple[str, ...] = ()

    def part(self, which: NDArray[np.bool_]) -> "Estimate":
        """Of those slices of a block (slices,)."""
        slices = len(self.converged)
        return replace(
            self,
            image=self.image[which],
            iterations=self.iterations[which],
            converged=self.converged[which],
            parameters={name: of[which] if of.size == slices else of for name, of in self.parameters.items()},
            misfit=None if self.misfit is None else self.misfit[which],
            objective=None if self.objective is None else self.objective[which],
            curves=tuple(curve for curve, wanted in zip(self.curves, which, strict=False) if wanted),
        )

    @classmethod
    def direct(cls, image: Image) -> "Estimate":
        """Of a method without iterations or parameters of its own."""
        slices = 1 if image.ndim == 2 else len(image)
        return cls(image, np.zeros(slices, np.int64), np.ones(slices, bool))
