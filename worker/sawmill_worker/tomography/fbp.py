"""Filtered back-projection with the exact fan-beam weights for any shift and tilt, at any explicit angles."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from sawmill_worker.tomography import _fbp_numba as kernels
from sawmill_worker.tomography.filters import RowFilter
from sawmill_worker.tomography.geometry import FloatArray, GeometryError, view_weights
from sawmill_worker.tomography.projector import Image, Projector
from sawmill_worker.vocabulary import FilterName, Weighting

Block = NDArray[np.float32]

# Slices are handled in vectors of so many.
LANES = 16
# Filtered at a time: few enough to stay near the processor, in memory that is not given back in between.
_FILTERED_BYTES = 2**19


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
    for part in _parts(views, cells):
        kernels.pair_up(prepared.filtered(data[part]), prepared.view_weight[part], prepared.cell_weight, pairs[part])
    gathered = pairs.view(np.uint64)[..., 0]
    size = projector.grid.size
    image: Image
    sense = projector.quarter_turn
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
        Line integrals. Multiples of 16 slices, up to 64, are fastest; a few cost as much as 16.

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
    prepared = Preparation.of(projector, weighting, filter_name, frequency_scaling)
    rows = np.empty((views, cells + 2, lanes_of(slices)), np.float32)

    def lay_out(part: slice) -> None:
        kernels.lay_out(prepared.filtered(data[part]), prepared.view_weight[part], prepared.cell_weight, rows[part])

    # Each thread takes what is next: views have nothing to wait for.
    with ThreadPoolExecutor(get_num_threads()) as pool:
        list(pool.map(lay_out, _parts(views, slices * cells)))
    kernels.back_project_block(rows, *prepared.frame, volume)
    return volume


def _parts(views: int, values: int) -> list[slice]:
    """The views, of so many values each, a few at a time."""
    step = max(1, _FILTERED_BYTES // (4 * values))
    return [slice(first, first + step) for first in range(0, views, step)]


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
    filtered : RowFilter
        With what comes before the filter.
    view_weight, cell_weight : (views,), (cells,) float64
        Their product weighs what is filtered.
    frame : _Frame
    """

    filtered: RowFilter
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
        exact = weighting == "exact"
        # A pixel shows the mean over its area: its shadow at the COR is averaged, or its noise would be a point's.
        shadow = grid.pixel_mm * frame.magnification
        before = r * (sdd + w * np.sin(tau)) / length if exact else np.ones(w.size)

        # The plain adjoint counts lengths: the density of rays at a pixel is |a| / (n.(x - S)).
        beta, power = geometry.angles_rad + frame.psi_rad, 2 if exact else 1
        return cls(
            RowFilter.of(before, pitch, filter_name, frequency_scaling, aperture_mm=shadow),
            0.5 * view_weights(geometry.angles_rad),
            np.full(w.size, sdd * np.cos(tau)) if exact else length,
            _Frame(beta, r, sdd, u_c, tau, pitch, *grid.low_mm, grid.pixel_mm, power),
        )
