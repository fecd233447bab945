"""The data that the model is compared with: a sinogram with angles and weights."""

from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells


@dataclass(frozen=True)
class SinogramData:
    """A sinogram with angles and weights, for comparison with the model."""

    sinogram: FloatArray  # (views, cells): line integrals
    angles_rad: FloatArray  # (views,): view angles in one sense of rotation
    cells: DetectorCells  # positions of the cells
    rays_per_cell: int | None = None  # rays per cell in the model; None averages over the cell
    weights: FloatArray | None = None  # (views, cells) or None: weight of each sample; None weighs all samples alike

    @property
    def samples(self) -> float:
        """Number of samples: the sum of the weights."""
        return self.sinogram.size if self.weights is None else float(self.weights.sum())

    def every(self, step: int) -> "SinogramData":
        """Select every `step`-th view."""
        if step == 1:
            return self
        weights = None if self.weights is None else np.ascontiguousarray(self.weights[::step])
        sinogram = np.ascontiguousarray(self.sinogram[::step])
        return replace(self, sinogram=sinogram, angles_rad=self.angles_rad[::step], weights=weights)

    def gram(self, phantom: Phantom, x: FloatArray) -> FloatArray:
        """Compute `analytic.gram` at a vector x (7,) in the order of `FitParameter`."""
        return analytic.gram(
            phantom,
            self.cells,
            SourceFrame.from_vector(x[FRAME]),
            self.angles_rad,
            self.sinogram,
            position_mm=(x[FitParameter.T_X], x[FitParameter.T_Y]),
            rays_per_cell=self.rays_per_cell,
            weights=self.weights,
        )
