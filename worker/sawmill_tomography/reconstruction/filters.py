"""The ramp filter of filtered back-projection and its windows."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
from sawmill_vocabulary import FilterName


def _window(name: FilterName, f: FloatArray) -> FloatArray:
    """Return the window at frequencies f relative to the cut-off, zero beyond it."""
    passed = np.abs(f) <= 1.0
    match name:
        case FilterName.RAM_LAK:
            value = np.ones_like(f)
        case FilterName.SHEPP_LOGAN:
            value = np.sinc(0.5 * f)
        case FilterName.COSINE:
            value = np.cos(0.5 * np.pi * f)
        case FilterName.HAMMING:
            value = 0.54 + 0.46 * np.cos(np.pi * f)
        case FilterName.HANN:
            value = 0.5 + 0.5 * np.cos(np.pi * f)
    return np.where(passed, value, 0.0)


def ramp_response(
    cells: int, pitch_mm: float, name: FilterName, frequency_scaling: float, *, aperture_mm: float = 0.0
) -> tuple[FloatArray, int]:
    """Return the frequency response of the windowed ramp for rfft, and the padded length.

    `aperture_mm` is the width on the detector over which the result is averaged: a pixel's shadow.

    The ramp is the transform of its band-limited kernel (Kak and Slaney 1988, eq. 3.61), not samples of |f|, so that
    the mean of the image is right. The response contains the cell width of the convolution integral.
    """
    if not 0.0 < frequency_scaling <= 1.0:
        raise GeometryError(f"frequency_scaling must be above 0 and at most 1, not {frequency_scaling}")
    length = scipy.fft.next_fast_len(2 * cells - 1, real=True)
    offset = np.minimum(np.arange(length), length - np.arange(length))
    kernel = np.zeros(length)
    kernel[0] = 0.25 / pitch_mm**2
    odd = offset % 2 == 1
    kernel[odd] = -1.0 / (np.pi * offset[odd] * pitch_mm) ** 2
    ramp = scipy.fft.rfft(kernel).real * pitch_mm
    relative = np.arange(ramp.size) * 2.0 / length / frequency_scaling
    mean = np.sinc(np.arange(ramp.size) * aperture_mm / (length * pitch_mm))
    return ramp * _window(name, relative) * mean, length


@dataclass(frozen=True, eq=False)
class RowFilter:
    """A filter of rows: a weight for each cell, then the windowed ramp over the row."""

    weight: NDArray[np.float32]  # (cells,) float32
    response: NDArray[np.float32]  # (length // 2 + 1,) float32: response by `ramp_response`
    length: int  # length of a row padded with zeros

    @classmethod
    def of(
        cls,
        weight: FloatArray,
        pitch_mm: float,
        name: FilterName,
        frequency_scaling: float,
        *,
        aperture_mm: float = 0.0,
    ) -> "RowFilter":
        """Make the filter by `ramp_response`."""
        response, length = ramp_response(weight.size, pitch_mm, name, frequency_scaling, aperture_mm=aperture_mm)
        return cls(weight.astype(np.float32), response.astype(np.float32), length)

    def __call__(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """Filter each row (..., cells) float32, in its unit per mm."""
        spectrum = scipy.fft.rfft(rows * self.weight, self.length)
        spectrum *= self.response
        filtered = np.asarray(scipy.fft.irfft(spectrum, self.length, overwrite_x=True), np.float32)
        return filtered[..., : self.weight.size]
