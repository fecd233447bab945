"""The discrete fan-beam projector A, ray-driven with exact intersection lengths, and its adjoint. Matrix-free."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.geometry import FanViews, FloatArray, GeometryError, rotate
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection import _projector_numba as kernels

Image = NDArray[np.float32]
Quarters = NDArray[np.int64]

# Slices that share one table of lengths: one vector register of the widest machines, and a block that fits a cache.
BLOCK = 16
# Fewer slices are faster split by quarters of the views, where the views repeat after a quarter turn.
_FEW = BLOCK // 2
# Vector widths of the kernels.
_LANES = (1, 4, BLOCK)
# Limits of the kernels' 32-bit counts: pixels of the image with its border, and the cells of all views, with one more
# at either end of a view.
LARGEST_SIZE, MOST_CELLS = 2**16 - 1 - kernels.BORDER, 2**31 - 1
_CACHE_LINE = 64
# Views a quarter turn apart to this precision share their tables: 0.2 micrometres at the edge of a log.
_SAME_ANGLE_RAD = 1e-6


@dataclass(frozen=True)
class Projector:
    """The projector A of one geometry and one image grid; every reconstruction takes it as first argument."""

    geometry: FanViews
    grid: ImageGrid

    def __post_init__(self) -> None:
        """Refuse a field that the source or the detector runs through, and sizes beyond the kernels' counts."""
        views, cells = self.geometry.sinogram_shape
        if self.grid.size > LARGEST_SIZE:
            raise GeometryError(f"size must be at most {LARGEST_SIZE} pixels, not {self.grid.size}")
        if views * (cells + 2) > MOST_CELLS:
            most = MOST_CELLS // (cells + 2)
            raise GeometryError(f"{views} views of {cells} cells are too many: at most {most} views of as many cells")
        corner = self.grid.reach_mm
        if corner >= self.geometry.clear_mm:
            cure = "choose a smaller field" + ("" if self.grid.is_centred else ", or one nearer to the rotation centre")
            raise GeometryError(
                f"field_mm {self.grid.field_mm:.6g} reaches {corner:.6g} mm from the centre of rotation, past the "
                f"source at {np.hypot(*self.geometry.source_mm.T).min():.6g} mm: {cure}"
            )

    def forward(self, image: ArrayLike) -> Image:
        """Compute line integrals float32, in the image's unit times mm.

        An image (size, size) [x, y] gives (views, detector). A block (slices, size, size) gives (slices, views,
        detector), and is several times faster a slice.
        """
        image = self._image(image)
        size = self.grid.size
        out = np.empty((*image.shape[:-2], *self.geometry.sinogram_shape), np.float32)
        images, lines = image.reshape(-1, size, size), out.reshape(-1, *self.geometry.sinogram_shape)
        for part, quarters, lanes in self._parts(len(images)):
            block = aligned(size + kernels.BORDER, size + kernels.BORDER, lanes)
            kernels.pack(images[part], quarters, block)
            forward = {1: kernels.forward_1, 4: kernels.forward_4, BLOCK: kernels.forward_16}[lanes]
            forward(block.ravel(), *self._rays, self._by_quarter(lines[part], quarters))
        return out

    def adjoint(self, sinogram: ArrayLike) -> Image:
        """Compute the transpose of `forward`: (views, detector) -> (size, size) float32, or a block to a block."""
        lines = self.sinogram(sinogram) if np.ndim(sinogram) == 2 else self.block(sinogram)
        size = self.grid.size
        out = np.empty((*lines.shape[:-2], size, size), np.float32)
        images, lines = out.reshape(-1, size, size), lines.reshape(-1, *self.geometry.sinogram_shape)
        for part, quarters, lanes in self._parts(len(images)):
            work = aligned(get_num_threads(), (size + kernels.BORDER) ** 2 * lanes)
            adjoint = {1: kernels.adjoint_1, 4: kernels.adjoint_4, BLOCK: kernels.adjoint_16}[lanes]
            adjoint(self._by_quarter(lines[part], quarters), *self._rays, work)
            kernels.unpack(work, quarters, lanes, images[part])
        return out

    def sinogram(self, sinogram: ArrayLike) -> Image:
        """Return the sinogram as float32, its shape checked against the geometry.

        Raises
        ------
        GeometryError
            If its shape is not (views, detector).
        """
        checked = np.ascontiguousarray(sinogram, np.float32)
        if checked.shape != self.geometry.sinogram_shape:
            raise GeometryError(
                f"the sinogram has shape {checked.shape}; this geometry makes (views, detector) = "
                f"{self.geometry.sinogram_shape}"
            )
        return checked

    def block(self, sinograms: ArrayLike) -> Image:
        """Return one or several sinograms as (slices, views, detector) float32, with its shape checked."""
        checked = np.ascontiguousarray(sinograms, np.float32)
        if checked.ndim == 3 and len(checked) and checked.shape[1:] == self.geometry.sinogram_shape:
            return checked
        return self.sinogram(checked)[None]

    def _image(self, image: ArrayLike) -> Image:
        checked = np.ascontiguousarray(image, np.float32)
        size = self.grid.size
        if checked.ndim not in {2, 3} or checked.shape[-2:] != (size, size):
            raise GeometryError(f"the image has shape {checked.shape}; this grid is {size} x {size}")
        return checked

    @cached_property
    def crossing(self) -> NDArray[np.bool_]:
        """Mask (views, detector) of the rays that cross the field."""
        shown: NDArray[np.bool_] = self.forward(np.ones((self.grid.size, self.grid.size), np.float32)) > 0.0
        if not shown.any():
            raise GeometryError("no measured ray crosses the field: check theta, the field's size and its centre")
        return shown

    @cached_property
    def quarter_turn(self) -> int:
        """Sense, 1 or -1, in which view k + views / 4 is view k after a quarter turn of the image; 0 if none."""
        geometry, views = self.geometry, self.geometry.angles_rad.size
        # Quarter turns of the image onto itself need the centre of rotation in its middle.
        if views % 4 or not self.grid.is_centred:
            return 0
        vectors = geometry.vectors()
        a_quarter_on = [np.roll(each, -(views // 4), axis=0) for each in vectors]
        for sense in (1, -1):
            turned = (np.stack(rotate(sense * 0.5 * math.pi, *each.T), -1) for each in vectors)
            off = [np.abs(after - one).max() for after, one in zip(a_quarter_on, turned, strict=True)]
            if max(off[:2]) < _SAME_ANGLE_RAD * geometry.clear_mm and off[2] < _SAME_ANGLE_RAD:
                return sense
        return 0

    def _parts(self, slices: int) -> Iterator[tuple[slice, Quarters, int]]:
        """Yield the slices that share a table, the quarter turns of each in it (as np.rot90), and the lanes."""
        turns = 4 if self.quarter_turn and slices <= _FEW else 1
        quarters = -self.quarter_turn * np.arange(turns) % 4
        for start in range(0, slices, BLOCK // turns):
            stop = min(start + BLOCK // turns, slices)
            yield slice(start, stop), quarters, next(lanes for lanes in _LANES if lanes >= (stop - start) * turns)

    def _by_quarter(self, lines: Image, quarters: Quarters) -> Image:
        """Reshape (slices, views, cells) to (slices, turns, views of one turn, cells)."""
        slices, views, cells = lines.shape
        return lines.reshape(slices, quarters.size, views // quarters.size, cells)

    @cached_property
    def _rays(self) -> tuple[int, FloatArray, FloatArray, FloatArray, FloatArray, float, float]:
        """Arguments of the kernels: image size, the views' vectors, the cells' u, half the field, a pixel's side."""
        grid = self.grid
        source, middle, axis = self.geometry.vectors()
        # The kernels' field is centred on their origin.
        source, middle = source - grid.centre_mm, middle - grid.centre_mm
        positions = self.geometry.borders_mm.mean(axis=1)
        return grid.size, source, middle, axis, positions, 0.5 * grid.field_mm, grid.pixel_mm


def aligned(*shape: int) -> Image:
    """Allocate memory from a cache line on: lanes that straddle two lines take up to half as long again."""
    bytes_ = 4 * math.prod(shape)
    memory = np.empty(bytes_ + _CACHE_LINE, np.uint8)
    begin = -memory.ctypes.data % _CACHE_LINE
    return memory[begin : begin + bytes_].view(np.float32).reshape(shape)
