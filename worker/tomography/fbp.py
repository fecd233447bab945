"""Filtered back-projection with the exact fan-beam weights for any shift and tilt, at any explicit angles."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worker.tomography import _fbp_numba as kernels
from worker.tomography.filters import FilterName, filter_rows
from worker.tomography.geometry import FloatArray, GeometryError, view_weights
from worker.tomography.projector import Image, Projector

Weighting = Literal["exact", "none"]
Block = NDArray[np.float32]

# Slices are handled in vectors of so many; a block of fewer than LEAST_BLOCK is faster one by one.
LANES = 16
LEAST_BLOCK = 5
# Filtered at a time: few enough to stay near the processor.
_FILTERED_BYTES = 2 * 2**20
# Views a quarter turn apart to this share their tables: 0.2 micrometres at the edge of a log.
_SAME_ANGLE_RAD = 1e-6


def fbp(
    projector: Projector,
    sinogram: ArrayLike,
    *,
    filter_name: FilterName = FilterName.HANN,
    frequency_scaling: float = 1.0,
    weighting: Weighting = "exact",
) -> Image:
    """Reconstruct one slice (design page, section 3; from Kak and Slaney 1988, chapter 3).

    Parameters
    ----------
    projector : Projector
        Geometry (views all round a full turn) and image grid.
    sinogram : (views, detector) float
        Line integrals.
    filter_name, frequency_scaling
        Window on the ramp, and its cut-off as a fraction of the Nyquist frequency.
    weighting : {"exact", "none"}
        "none" is the published pipeline: ramp, then the plain adjoint, no cosine and no distance weight.

    Returns
    -------
    (size, size) float32
        [x, y], in the sinogram's unit per mm.

    Raises
    ------
    GeometryError
        If the shapes do not fit or the views do not cover the full turn.
    """
    data = projector.sinogram(sinogram)
    prepared = Preparation.of(projector, weighting, filter_name, frequency_scaling)
    views, cells = data.shape
    pairs = np.empty((views, cells + 2, 2), np.float32)
    kernels.pair_up(prepared.filtered(data), prepared.view_weight, prepared.cell_weight, pairs)
    gathered = pairs.view(np.uint64)[..., 0]
    size = projector.grid.size
    image: Image
    # Quarter turns of the image onto itself need the centre of rotation in its middle.
    sense = _quarter_turn(projector.geometry.angles_rad) if projector.grid.is_centred else 0
    if sense == 0:
        image = np.empty((size, size), np.float32)
        kernels.back_project(gathered, *prepared.frame, image)
        return image
    quarters = np.empty((4, size, size), np.float32)
    kernels.back_project_quarters(gathered, *prepared.frame, quarters)
    # What the views n quarter turns on see of a pixel, the first see of the pixel turned back by as much.
    image = quarters[0]
    for n in (1, 2, 3):
        image += np.rot90(quarters[n], sense * n)
    return image


def fbp_block(
    projector: Projector,
    stack: ArrayLike,
    *,
    filter_name: FilterName = FilterName.HANN,
    frequency_scaling: float = 1.0,
    weighting: Weighting = "exact",
) -> Block:
    """Reconstruct slices that share the geometry, as `fbp` does each, several times as fast.

    Parameters
    ----------
    stack : (views, slices, detector) float
        Line integrals. Multiples of 16 slices, up to 64, are fastest.

    Returns
    -------
    (slices, size, size) float32
        [slice, x, y], in the stack's unit per mm.

    Raises
    ------
    GeometryError
        If the shapes do not fit or the views do not cover the full turn.
    """
    data = np.asarray(stack, np.float32)
    expected = projector.geometry.sinogram_shape
    if data.ndim != 3 or (data.shape[0], data.shape[2]) != expected:
        raise GeometryError(
            f"the stack has shape {data.shape}; this geometry makes (views, slices, detector) = "
            f"({expected[0]}, any, {expected[1]})"
        )
    views, slices, cells = data.shape
    size = projector.grid.size
    volume = np.empty((slices, size, size), np.float32)
    if slices < LEAST_BLOCK:
        for n in range(slices):
            volume[n] = fbp(
                projector,
                data[:, n],
                filter_name=filter_name,
                frequency_scaling=frequency_scaling,
                weighting=weighting,
            )
        return volume
    prepared = Preparation.of(projector, weighting, filter_name, frequency_scaling)
    rows = np.empty((views, cells + 2, lanes_of(slices)), np.float32)
    step = max(1, _FILTERED_BYTES // (4 * slices * cells))
    for first in range(0, views, step):
        part = slice(first, first + step)
        kernels.lay_out(prepared.filtered(data[part]), prepared.view_weight[part], prepared.cell_weight, rows[part])
    kernels.back_project_block(rows, *prepared.frame, volume)
    return volume


def lanes_of(slices: int) -> int:
    """Slices rounded up to whole vectors, as `fbp_block` keeps them."""
    return -(-slices // LANES) * LANES


class _Frame(NamedTuple):
    """The kernels' arguments: angles from the source, the source frame, the detector and the grid."""

    beta: FloatArray
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
    """Filter, weights and kernel arguments of one geometry: the same for one slice and for a block.

    Attributes
    ----------
    filtered : callable
        (..., cells) float32 to the same: what comes before the filter, and the filter.
    view_weight, cell_weight : (views,), (cells,) float64
        Their product weighs what is filtered.
    frame : _Frame
    """

    filtered: Callable[[NDArray[np.float32]], NDArray[np.float32]]
    view_weight: FloatArray
    cell_weight: FloatArray
    frame: _Frame

    @classmethod
    def of(
        cls, projector: Projector, weighting: Weighting, filter_name: FilterName, frequency_scaling: float
    ) -> "Preparation":
        """Of a geometry and a grid (design page, section 3)."""
        geometry, grid = projector.geometry, projector.grid
        frame, pitch = geometry.frame, geometry.scanner.detector_pitch_mm
        r, sdd, u_c, tau = frame.source_distance_mm, frame.source_to_detector_mm, frame.cor_column_mm, frame.tilt_rad
        # The ray to cell m from the source: a = (w cos tau, SDD + w sin tau).
        w = geometry.scanner.cell_centres_mm - u_c
        length = np.hypot(w * np.cos(tau), sdd + w * np.sin(tau))
        cosine = (r * (sdd + w * np.sin(tau)) / length).astype(np.float32)
        exact = weighting == "exact"
        # A pixel shows the mean over its area: its shadow at the COR is averaged, or its noise would be a point's.
        shadow = grid.pixel_mm * frame.magnification

        def filtered(rows: NDArray[np.float32]) -> NDArray[np.float32]:
            weighted = rows * cosine if exact else rows
            return filter_rows(weighted, pitch, filter_name, frequency_scaling, aperture_mm=shadow)

        # The plain adjoint counts lengths: the density of rays at a pixel is |a| / (n.(x - S)).
        beta, power = geometry.angles_rad + frame.psi_rad, 2 if exact else 1
        return cls(
            filtered,
            0.5 * view_weights(geometry.angles_rad),
            np.full(w.size, sdd * np.cos(tau)) if exact else length,
            _Frame(beta, r, sdd, u_c, tau, pitch, *grid.low_mm, grid.pixel_mm, power),
        )


def _quarter_turn(angles_rad: FloatArray) -> int:
    """The sense, 1 or -1, in which view k + views / 4 is a quarter turn after view k; 0 where it is not."""
    if angles_rad.size % 4:
        return 0
    turned = np.roll(angles_rad, -(angles_rad.size // 4)) - angles_rad
    for sense in (1, -1):
        off = np.remainder(turned - sense * 0.5 * math.pi + math.pi, 2.0 * math.pi) - math.pi
        if np.abs(off).max() < _SAME_ANGLE_RAD:
            return sense
    return 0
