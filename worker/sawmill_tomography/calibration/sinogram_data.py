"""Data that the model is compared with: a sinogram with angles and weights, and the disc in which ray errors count."""

from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, GeometryError, Scanner

# At most this share of the views are few: faults of single views, and noise, are in no more.
FEW_VIEWS = 0.05


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


def refuse_log_beyond_source(stated_mm: float | None, scanner: Scanner) -> None:
    """Refuse a radius of the largest log that would hold the source.

    Raises
    ------
    GeometryError
        If the radius is as large as the distance of the source from the COR, or larger.
    """
    if stated_mm is not None and stated_mm >= scanner.source_to_cor_mm:
        raise GeometryError(
            f"log_radius_mm {stated_mm:g} must be less than source_to_cor_mm {scanner.source_to_cor_mm:g}: no log "
            "holds the source"
        )


def counted_radius_mm(stated_mm: float | None, seen: Phantom) -> float:
    """Return the radius of the disc around the COR in which ray errors are counted.

    docs/look-up/conventions.md#ray-error defines it.
    """
    return min(LARGEST_ASSUMED_LOG_RADIUS_MM, seen.radius_mm) if stated_mm is None else stated_mm
