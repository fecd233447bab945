"""The result of every reconstruction method."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """A reconstruction of one slice or of a block, and how it was made.

    Attributes
    ----------
    image : (size, size) or (slices, size, size) float32
        [x, y], in the sinogram's unit per mm.
    iterations : (slices,) int64
        Number of iterations; 0 for a direct method.
    converged : (slices,) bool
        True if the tolerance was reached before the iterations ran out.
    parameters : mapping of str to (slices,) or (1,) float64
        Values that the method used, given or chosen, by the names of its options; one value may serve all slices.
    noise : float, optional
        Root mean square of the standard deviation of the data, given or estimated.
    misfit : (slices,) float64, optional
        Residual: root mean square of (A x - y) / noise. It is near 1 if geometry and noise are right, far above if
        not. A direct method does not compute it.
    objective : (slices,) float64, optional
        Minimised objective, at the image; for coupled slices the sum over all of them.
    curves : tuple of mapping of str to (points,) float64
        One curve a slice, from which its parameters were chosen, by column; empty where the method has none.
    remarks : tuple of str
        Remarks on the data and the fit for the user.
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
