"""What the model is compared with: a sinogram, its angles and weights."""

from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells


@dataclass(frozen=True)
class SinogramData:
    """What the model is compared with.

    Attributes
    ----------
    sinogram : (views, cells) float64
        Line integrals.
    angles_rad : (views,) float64
        As one sense of rotation reads them.
    cells : DetectorCells
        Where the cells lie.
    rays_per_cell : int or None
        Rays per cell in the model; None averages over the cell.
    weights : (views, cells) float64 or None
        Of each sample; None weighs all alike.
    """

    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    rays_per_cell: int | None = None
    weights: FloatArray | None = None

    @property
    def samples(self) -> float:
        """Number of samples, by weight."""
        return self.sinogram.size if self.weights is None else float(self.weights.sum())

    def every(self, step: int) -> "SinogramData":
        """Every `step`-th view."""
        if step == 1:
            return self
        weights = None if self.weights is None else np.ascontiguousarray(self.weights[::step])
        sinogram = np.ascontiguousarray(self.sinogram[::step])
        return replace(self, sinogram=sinogram, angles_rad=self.angles_rad[::step], weights=weights)

    def gram(self, phantom: Phantom, x: FloatArray) -> FloatArray:
        """`analytic.gram` at a vector x (7,) in the order of `FitParameter`."""
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
