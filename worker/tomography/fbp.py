"""Filtered back-projection with the exact fan-beam weights for any shift and tilt, at any explicit angles."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from worker.tomography._fbp_numba import back_project
from worker.tomography.filters import FilterName, filter_rows
from worker.tomography.geometry import view_weights
from worker.tomography.projector import Image, Projector

Weighting = Literal["exact", "none"]


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
    geometry, grid = projector.geometry, projector.grid
    scanner, frame = geometry.scanner, geometry.frame
    r, sdd, u_c, tau = frame.source_distance_mm, frame.source_to_detector_mm, frame.cor_column_mm, frame.tilt_rad
    views, cells = data.shape
    weights = 0.5 * view_weights(geometry.angles_rad)
    # The ray to cell m from the source: a = (w cos tau, SDD + w sin tau).
    w = scanner.cell_centres_mm - u_c
    length = np.hypot(w * np.cos(tau), sdd + w * np.sin(tau))
    if weighting == "exact":
        cosine = r * (sdd + w * np.sin(tau)) / length
        data = data * cosine.astype(np.float32)
        after, power = np.full(cells, sdd * np.cos(tau)), 2
    else:
        # The plain adjoint counts lengths: the density of rays at a pixel is |a| / (n.(x - S)).
        after, power = length, 1
    rows = np.zeros((views, cells + 2), np.float32)
    # A pixel shows the mean over its area: its shadow at the COR is averaged, or its noise would be that of a point.
    shadow = grid.pixel_mm * frame.magnification
    rows[:, 1:-1] = filter_rows(data, scanner.detector_pitch_mm, filter_name, frequency_scaling, aperture_mm=shadow)
    rows[:, 1:-1] *= (weights[:, None] * after[None, :]).astype(np.float32)
    out = np.empty((grid.size, grid.size), np.float32)
    back_project(
        rows,
        geometry.angles_rad + frame.psi_rad,
        r,
        sdd,
        u_c,
        tau,
        scanner.detector_pitch_mm,
        0.5 * grid.field_mm,
        grid.pixel_mm,
        power,
        out,
    )
    return out
