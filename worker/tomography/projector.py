"""The discrete fan-beam projector A, ray-driven with exact intersection lengths, and its adjoint. Matrix-free."""

from dataclasses import dataclass

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from worker.tomography import _projector_numba as kernels
from worker.tomography.geometry import FanBeamGeometry, GeometryError
from worker.tomography.image_grid import ImageGrid

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Projector:
    """A for one geometry and one image grid; every reconstruction takes it first."""

    geometry: FanBeamGeometry
    grid: ImageGrid

    def __post_init__(self) -> None:
        """Refuse a field that the source or the detector runs through."""
        frame = self.geometry.frame
        corner = self.grid.field_mm / np.sqrt(2.0)
        if corner >= frame.source_distance_mm * np.cos(frame.tilt_rad):
            raise GeometryError(
                f"field_mm {self.grid.field_mm:.6g} reaches {corner:.6g} mm from the centre of rotation, past the "
                f"source at {frame.source_distance_mm:.6g} mm: choose a smaller field"
            )

    def forward(self, image: ArrayLike) -> Image:
        """Line integrals (views, detector) float32 of an image (size, size) [x, y], in the image's unit times mm."""
        image = self._image(image)
        out = np.empty(self.geometry.sinogram_shape, np.float32)
        source, centre, axis = self.geometry.vectors()
        kernels.forward(image, np.ascontiguousarray(image.T), source, centre, axis, *self._lengths(), out)
        return out

    def adjoint(self, sinogram: ArrayLike) -> Image:
        """The transpose of `forward`: (views, detector) -> (size, size) float32."""
        out = np.empty((self.grid.size, self.grid.size), np.float32)
        threads = min(get_num_threads(), self.geometry.angles_rad.size)
        source, centre, axis = self.geometry.vectors()
        kernels.adjoint(self.sinogram(sinogram), source, centre, axis, *self._lengths(), threads, out)
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

    def _image(self, image: ArrayLike) -> Image:
        checked = np.ascontiguousarray(image, np.float32)
        if checked.shape != (self.grid.size, self.grid.size):
            raise GeometryError(
                f"the image has shape {checked.shape}; this grid is {self.grid.size} x {self.grid.size}"
            )
        return checked

    def _lengths(self) -> tuple[float, float, float]:
        """Detector pitch, half the field, side of a pixel."""
        return self.geometry.scanner.detector_pitch_mm, 0.5 * self.grid.field_mm, self.grid.pixel_mm
