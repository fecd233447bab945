"""The discrete fan-beam projector A, ray-driven with exact intersection lengths, and its adjoint. Matrix-free."""

from dataclasses import dataclass

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from worker.tomography import _projector_numba as kernels
from worker.tomography.geometry import FanBeamGeometry, FloatArray, GeometryError
from worker.tomography.image_grid import ImageGrid

Image = NDArray[np.float32]

# Slices that share one table of lengths: one vector register of the widest machines, and a block that fits a cache.
BLOCK = 16


@dataclass(frozen=True)
class Projector:
    """A for one geometry and one image grid; every reconstruction takes it first."""

    geometry: FanBeamGeometry
    grid: ImageGrid

    def __post_init__(self) -> None:
        """Refuse a field that the source or the detector runs through."""
        frame = self.geometry.frame
        corner = self.grid.reach_mm
        if corner >= frame.source_distance_mm * np.cos(frame.tilt_rad):
            raise GeometryError(
                f"field_mm {self.grid.field_mm:.6g} reaches {corner:.6g} mm from the centre of rotation, past the "
                f"source at {frame.source_distance_mm:.6g} mm: choose a smaller field"
            )

    def forward(self, image: ArrayLike) -> Image:
        """Line integrals float32, in the image's unit times mm.

        An image (size, size) [x, y] gives (views, detector). A block (slices, size, size) gives (slices, views,
        detector), and is several times faster a slice.
        """
        image = self._image(image)
        out = np.empty((*image.shape[:-2], *self.geometry.sinogram_shape), np.float32)
        if image.size == self.grid.size**2:
            bordered = np.pad(image.reshape(image.shape[-2:]), (1, kernels.BORDER - 1))
            kernels.forward(bordered.ravel(), *self._rays(), out.reshape(out.shape[-2:]))
            return out
        for start in range(0, len(image), BLOCK):
            part = np.moveaxis(image[start : start + BLOCK], 0, -1)
            block = np.pad(part, ((1, kernels.BORDER - 1), (1, kernels.BORDER - 1), (0, 0)))
            lines = np.empty((*self.geometry.sinogram_shape, part.shape[-1]), np.float32)
            kernels.forward_block(block.ravel(), *self._rays(), lines)
            out[start : start + BLOCK] = np.moveaxis(lines, -1, 0)
        return out

    def adjoint(self, sinogram: ArrayLike) -> Image:
        """The transpose of `forward`: (views, detector) -> (size, size) float32, or a block to a block."""
        lines = self.sinogram(sinogram) if np.ndim(sinogram) == 2 else self.block(sinogram)
        size = self.grid.size
        out = np.empty((*lines.shape[:-2], size, size), np.float32)
        threads = min(get_num_threads(), self.geometry.angles_rad.size)
        pixels = (size + kernels.BORDER) ** 2
        if out.size == size**2:
            work = np.empty((threads, pixels), np.float32)
            kernels.adjoint(lines.reshape(lines.shape[-2:]), *self._rays(), work, out.reshape(size, size))
            return out
        for start in range(0, len(lines), BLOCK):
            part = np.ascontiguousarray(np.moveaxis(lines[start : start + BLOCK], 0, -1))
            work = np.empty((threads, pixels * part.shape[-1]), np.float32)
            kernels.adjoint_block(part, *self._rays(), work, out[start : start + BLOCK])
        return out

    def sinogram(self, sinogram: ArrayLike) -> Image:
        """The sinogram as float32, its shape checked against the geometry.

        Raises
        ------
        GeometryError
            If it is not (views, detector).
        """
        checked = np.ascontiguousarray(sinogram, np.float32)
        if checked.shape != self.geometry.sinogram_shape:
            raise GeometryError(
                f"the sinogram has shape {checked.shape}; this geometry makes (views, detector) = "
                f"{self.geometry.sinogram_shape}"
            )
        return checked

    def block(self, sinograms: ArrayLike) -> Image:
        """One sinogram or several as (slices, views, detector) float32, the shape checked against the geometry.

        Raises
        ------
        GeometryError
            If it is neither (views, detector) nor (slices, views, detector) with at least one slice.
        """
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

    def _rays(self) -> tuple[int, FloatArray, FloatArray, FloatArray, float, float, float]:
        """What the kernels need: image size, the views' vectors, detector pitch, half the field, a pixel's side."""
        grid = self.grid
        pitch = self.geometry.scanner.detector_pitch_mm
        source, middle, axis = self.geometry.vectors()
        # The kernels' field is centred on their origin.
        source, middle = source - grid.centre_mm, middle - grid.centre_mm
        return grid.size, source, middle, axis, pitch, 0.5 * grid.field_mm, grid.pixel_mm
