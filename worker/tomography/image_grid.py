"""Where an image's pixels lie."""

import math
from dataclasses import dataclass

import numpy as np

from worker.tomography.geometry import FloatArray, GeometryError


@dataclass(frozen=True)
class ImageGrid:
    """A square image [x, y] of size x size pixels over a field centred on the COR."""

    size: int
    field_mm: float

    def __post_init__(self) -> None:
        """Refuse grids without pixels."""
        if self.size < 1:
            raise GeometryError(f"size must be at least one pixel, not {self.size}")
        if not (math.isfinite(self.field_mm) and self.field_mm > 0.0):
            raise GeometryError(f"field_mm must be a positive number of millimetres, not {self.field_mm}")

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel, h."""
        return self.field_mm / self.size

    @property
    def centres_mm(self) -> FloatArray:
        """Pixel centres along either axis, -half + (i + 1/2) h, (size,)."""
        return (np.arange(self.size, dtype=np.float64) + 0.5) * self.pixel_mm - 0.5 * self.field_mm
