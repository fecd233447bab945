"""Square images over the plane of a slice: the positions of their pixels."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError

# In a smaller field a log needs more pixels than can be counted.
SMALLEST_FIELD_MM = 1e-3


@dataclass(frozen=True)
class ImageGrid:
    """A square image [x, y] of size x size pixels over a square field."""

    size: int  # pixels along each side
    field_mm: float  # side of the field
    centre_mm: tuple[float, float] = (0.0, 0.0)  # (x, y): middle of the field; the COR by default

    def __post_init__(self) -> None:
        """Refuse grids without pixels, and grids without a finite field."""
        if self.size < 1:
            raise GeometryError(f"size must be at least one pixel, not {self.size}")
        if not (math.isfinite(self.field_mm) and self.field_mm >= SMALLEST_FIELD_MM):
            raise GeometryError(
                f"field_mm must be a positive number of millimetres, {SMALLEST_FIELD_MM:g} or more, not {self.field_mm}"
            )
        if not all(math.isfinite(value) for value in self.centre_mm):
            raise GeometryError(f"centre_mm must be two finite numbers of millimetres, not {self.centre_mm}")

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel, h."""
        return self.field_mm / self.size

    @property
    def is_centred(self) -> bool:
        """True if the field's middle is the COR."""
        return self.centre_mm == (0.0, 0.0)

    @property
    def low_mm(self) -> tuple[float, float]:
        """The field's low ends along x and y."""
        half = 0.5 * self.field_mm
        return self.centre_mm[0] - half, self.centre_mm[1] - half

    @property
    def x_mm(self) -> FloatArray:
        """Pixel centres along x, low end + (i + 1/2) h, (size,)."""
        return self._centres_mm(0)

    @property
    def y_mm(self) -> FloatArray:
        """Pixel centres along y, low end + (j + 1/2) h, (size,)."""
        return self._centres_mm(1)

    @property
    def reach_mm(self) -> float:
        """Distance from the COR to the farthest corner of the field."""
        half = 0.5 * self.field_mm
        return math.hypot(abs(self.centre_mm[0]) + half, abs(self.centre_mm[1]) + half)

    @property
    def nearest_mm(self) -> float:
        """Distance from the COR to the nearest point of the field; 0 where the field holds the COR."""
        half = 0.5 * self.field_mm
        return math.hypot(*(max(abs(middle) - half, 0.0) for middle in self.centre_mm))

    def around(self, radius_mm: float) -> tuple["ImageGrid", tuple[slice, slice]]:
        """Return a grid of the same pixels that also holds a disc around the COR, and the slices of this grid in it.

        Methods that explain the measured rays need pixels wherever there is wood: they reconstruct the larger image and
        cut this grid's part out of it, `image[part]`.
        """
        h = self.pixel_mm
        ends = [
            (math.ceil(max(low + radius_mm, 0.0) / h), math.ceil(max(radius_mm - low - self.field_mm, 0.0) / h))
            for low in self.low_mm
        ]
        before_x, before_y = (before for before, _ in ends)
        size = self.size + max(before + after for before, after in ends)
        low_x, low_y = self.low_mm[0] - before_x * h, self.low_mm[1] - before_y * h
        larger = ImageGrid(size, size * h, (low_x + 0.5 * size * h, low_y + 0.5 * size * h))
        return larger, (slice(before_x, before_x + self.size), slice(before_y, before_y + self.size))

    def _centres_mm(self, axis: int) -> FloatArray:
        return self.low_mm[axis] + (np.arange(self.size, dtype=np.float64) + 0.5) * self.pixel_mm
