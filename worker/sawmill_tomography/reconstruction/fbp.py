"""Filtered back-projection at any explicit angles, with the exact fan-beam weights for any shift and tilt."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.detector_shape import FlatDetector
from sawmill_tomography.geometry.geometry import (
    SAME_MM,
    FloatArray,
    GeometryError,
    cell_centres_mm,
    turning,
    view_weights,
)
from sawmill_tomography.projection.projector import Image, Projector, aligned
from sawmill_tomography.reconstruction import _fbp_numba as kernels
from sawmill_tomography.reconstruction import cost
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.method import DirectMethod
from sawmill_tomography.sinograms.noise import misfit_cause
from sawmill_vocabulary import FilterName, Weighting
from sawmill_vocabulary.image_messages import ImageMessage


def _window(name: FilterName, f: FloatArray) -> FloatArray:
    """Return the window at frequencies f relative to the cut-off, zero beyond it."""
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
    return np.where(np.abs(f) <= 1.0, value, 0.0)


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
    return ramp * _window(name, relative) * np.sinc(np.arange(ramp.size) * aperture_mm / (length * pitch_mm)), length


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
        return np.asarray(scipy.fft.irfft(spectrum, self.length, overwrite_x=True), np.float32)[..., : self.weight.size]


Block = Image

# Bytes filtered at a time: few enough to stay in the cache, in memory that is not returned in between
# (benchmarks/reconstruction_speed.py).
_FILTERED_BYTES = 2**17
# A remark needs this number of views, this share of the data and this multiple of the noise. From as many views and
# with the right geometry, filter and pixels leave at most 9 % of the data (phantoms and logs, frequency scaling from
# 0.05, 16 to 2048 pixels), and noise is amplified to at most 3.7 times itself. Rays that are off by 8 mm leave 13 to
# 17 %. From 20 views a right and a wrong geometry leave the same (tests/calibration/test_methods.py).
REMARK_VIEWS, REMARK_SHARE, REMARK_NOISE = 90, 0.1, 4.0
# Shifts of the views explain more than a third of such a misfit where u_c is wrong or the object moved, and at most
# 0.02 where hardening, scatter or blur alone are the cause (tests/calibration/test_misfit.py).
DISPLACED = 0.1


def fbp(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    filter_name: FilterName = FilterName.HANN,
    frequency_scaling: float = 1.0,
    weighting: Weighting = "exact",
) -> Estimate:
    """Reconstruct one slice or a block of slices (Kak and Slaney 1988, chapter 3).

    docs/look-up/conventions.md#filtered-back-projection has the formulas.

    Parameters
    ----------
    projector : Projector
        Geometry (views all round a full turn) and image grid.
    sinogram : (views, detector) or (slices, views, detector) float
        Line integrals. A block is several times as fast a slice; multiples of 16 slices, up to 64, are fastest, a few
        cost as much as 16. The transpose of an array (views, slices, detector) is not copied.
    filter_name, frequency_scaling
        Window on the ramp, and its cut-off as a fraction of the Nyquist frequency.
    weighting : {"exact", "none"}
        "none" is the published pipeline: ramp, then the plain adjoint, no cosine and no distance weight.

    Raises
    ------
    GeometryError
        If the shapes do not fit or the views do not cover the full turn.
    """
    geometry = turning(projector.geometry)
    if geometry.uneven_mm > SAME_MM:
        sinogram = FlatDetector.of(geometry.borders_mm, geometry.scanner).resampled(np.asarray(sinogram, np.float32))
    if np.ndim(sinogram) == 3:
        data = _block(projector, sinogram)
        prepared = Preparation.of(projector, weighting, filter_name, frequency_scaling)
        return Estimate.direct(_back_projected_block(projector, data, prepared))
    line = projector.sinogram(sinogram)
    return Estimate.direct(
        _back_projected(projector, line, Preparation.of(projector, weighting, filter_name, frequency_scaling))
    )


def _block(projector: Projector, sinograms: ArrayLike) -> Block:
    """Transpose sinograms (slices, views, detector) to (views, slices, detector) float32, as the kernels read them."""
    data = np.asarray(sinograms, np.float32)
    expected = projector.geometry.sinogram_shape
    if data.shape[1:] != expected:
        raise GeometryError(
            f"the block has shape {data.shape}; this geometry makes (slices, views, detector) = "
            f"(any, {expected[0]}, {expected[1]})"
        )
    return data.transpose(1, 0, 2)


def _back_projected(projector: Projector, line: Image, prepared: "Preparation") -> Image:
    views, cells = line.shape
    sense = projector.quarter_turn
    if sense == 0:
        pairs = np.empty((views, cells + 2, 2), np.float32)
        image: Image = np.empty((projector.grid.size, projector.grid.size), np.float32)
        _filter(prepared, line, kernels.pair_up, pairs)
        kernels.back_project(pairs.view(np.uint64)[..., 0], *prepared.frame, image)
        return image
    # A pixel in the views n quarter turns later is the pixel turned back by n quarters in the first views: these views
    # are treated as another slice in the same block.
    quarters = _back_projected_block(projector, line.reshape(4, -1, cells).transpose(1, 0, 2), prepared)
    image = quarters[0]
    for n in (1, 2, 3):
        image += np.rot90(quarters[n], sense * n)
    return image


def _back_projected_block(projector: Projector, data: Block, prepared: "Preparation") -> Image:
    """Back-project rows (views, slices, cells) to slices; the views are the geometry's or its first ones."""
    views, slices, cells = data.shape
    volume = np.empty((slices, projector.grid.size, projector.grid.size), np.float32)
    rows = aligned(views, cells + 2, cost.lanes_of(slices))
    _filter(prepared, data, kernels.lay_out, rows)
    back_project = kernels.back_project_4 if rows.shape[2] == cost.FEW_LANES else kernels.back_project_16
    back_project(rows, *prepared.frame, volume)
    return volume


def _filter(prepared: "Preparation", data: Image, lay_out: Callable[..., None], rows: Image) -> None:
    """Write filtered and weighted data (views, ..., cells) to rows, in the layout of a back-projection kernel."""

    def work_on(part: slice) -> None:
        lay_out(prepared.filtered(data[part]), prepared.view_weight[part], prepared.cell_weight, rows[part])

    # Each thread takes the next part: no part depends on another.
    with ThreadPoolExecutor(get_num_threads()) as pool:
        list(pool.map(work_on, _parts(len(data), data[0].size)))


def _parts(views: int, values: int) -> list[slice]:
    """Split the views, of `values` values each, into parts of a few views."""
    step = max(1, _FILTERED_BYTES // (4 * values))
    return [slice(first, first + step) for first in range(0, views, step)]


class _Frame(NamedTuple):
    """The kernels' arguments: the source's angle in each view, the source frame, the detector and the grid."""

    source_angle_rad: FloatArray
    big_r: float
    sdd: float
    u_c: float
    tau: float
    pitch: float
    low_x: float
    low_y: float
    pixel: float
    power: int


@dataclass(frozen=True, eq=False)
class Preparation:
    """Filter, weights and kernel arguments of one geometry: the same for one slice and for a block."""

    filtered: RowFilter  # filter, including the weights before the filter
    view_weight: FloatArray  # (views,): factors of the weight of the filtered values
    cell_weight: FloatArray  # (cells,)
    frame: _Frame

    @classmethod
    def of(
        cls, projector: Projector, weighting: Weighting, filter_name: FilterName, frequency_scaling: float
    ) -> "Preparation":
        """Prepare a geometry and a grid (docs/look-up/conventions.md#filtered-back-projection)."""
        geometry, grid = turning(projector.geometry), projector.grid
        frame, pitch = geometry.frame, geometry.scanner.detector_pitch_mm
        r, sdd, u_c, tau = frame.source_distance_mm, frame.source_to_detector_mm, frame.cor_column_mm, frame.tilt_rad
        # The ray to cell m from the source: a = (w cos tau, SDD + w sin tau).
        w = cell_centres_mm(geometry.scanner) - u_c
        length = np.hypot(w * np.cos(tau), sdd + w * np.sin(tau))
        exact = weighting == "exact"
        # A pixel is the mean over its area: without averaging over its shadow at the COR it would be as noisy as a
        # point.
        shadow = grid.pixel_mm * frame.magnification
        before = r * (sdd + w * np.sin(tau)) / length if exact else np.ones(w.size)

        # The plain adjoint sums lengths: the density of rays at a pixel is |a| / (n.(x - S)).
        source_angles, power = geometry.angles_rad + frame.psi_rad, 2 if exact else 1
        return cls(
            RowFilter.of(before, pitch, filter_name, frequency_scaling, aperture_mm=shadow),
            0.5 * view_weights(geometry.angles_rad),
            np.full(w.size, sdd * np.cos(tau)) if exact else length,
            _Frame(source_angles, r, sdd, u_c, tau, pitch, *grid.low_mm, grid.pixel_mm, power),
        )


@dataclass(frozen=True)
class FilteredBackProjection(DirectMethod):
    """The method `fbp` in the table of methods."""

    filter: FilterName = FilterName.HANN
    frequency_scaling: float = 1.0
    weighting: Weighting = "exact"

    def reconstruct(self, projector: Projector, lines: Image) -> Estimate:
        """Reconstruct a block."""
        return fbp(
            projector,
            lines,
            filter_name=self.filter,
            frequency_scaling=self.frequency_scaling,
            weighting=self.weighting,
        )

    def seconds(self, projector: Projector, slices: int) -> float:
        """Estimate the seconds by a fit to measured times (docs/evidence/speed.md)."""
        return cost.seconds(*projector.geometry.sinogram_shape, projector.grid.size, slices)

    def remark_on(self, projector: Projector, image: Image, misfit: float, line: Image, noise: float) -> str | None:
        """Return a remark if the misfit is larger than filtering alone causes."""
        residual, size = misfit * noise, float(np.sqrt(np.mean(np.square(line, dtype=np.float64))))
        if len(line) < REMARK_VIEWS or misfit < REMARK_NOISE or residual < REMARK_SHARE * size:
            return None
        cause = misfit_cause(projector, image, line, np.full(line.shape, noise), displaced=DISPLACED)
        return ImageMessage.FILTERED_MISSES_DATA(cause, percent=100.0 * REMARK_SHARE, times=REMARK_NOISE)
