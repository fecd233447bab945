"""Rays behind metal as the other views see the log, and the errors of that.

A total-variation image of the rays without metal gives every ray, and what the measured rays depart from it by is
interpolated linearly along the detector (normalised metal artefact reduction: Meyer et al. 2010, Medical Physics 37,
5482). The same is done with as many samples next to the metal, which are known: they give the errors.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.drift.levelled_rays import AirFit, fitted_air
from sawmill_tomography.drift.log_screening import fan_for_images, one_thread
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.metal import image_of_other_rays
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.sinograms.present_rows import Run, bridged_samples, runs_of

# The constants of this file were measured with benchmarks/production_logs.py.
# Pixels of the image, and their largest number along a side.
PIXEL_MM, LARGEST_SIZE = 2.0, 256
# The error is 0 at both ends of a run of interpolated samples; between them this number of half waves describes it.
HALF_WAVES = 3
# The known run next to a run is this number of lengths away. Nearer, the image misses more of the log there.
AWAY = 2


class RaysBehindMetal(NamedTuple):
    """Line integrals of which samples are interpolated, and the errors of these."""

    rays: FloatArray  # (views, detector)
    of_view: NDArray[np.intp]  # (errors,) int: the view of each error
    errors: FloatArray  # (errors, detector)


def rays_behind_metal(
    scanner: Scanner, sinogram: FloatArray, angles_rad: FloatArray, start: SourceFrame, metal: NDArray[np.bool_] | None
) -> RaysBehindMetal:
    """Interpolate the samples that see metal.

    `sinogram` (views, detector): line integrals without faulty cells and corrupt views. `angles_rad` (views,): view
    angles in the calibrated sense of rotation. `metal` (views, detector) bool or None.
    """
    if metal is None or not metal.any():
        return RaysBehindMetal(sinogram, np.zeros(0, np.intp), np.zeros((0, sinogram.shape[1])))
    runs = runs_of(metal)
    known = _runs_beside(runs, metal)
    trial = np.zeros_like(metal)
    for view, first, length in known:
        trial[view, first : first + length] = True
    # Without air next to the log there is no image: the departures are then the rays themselves.
    air = fitted_air(np.asarray(bridged_samples(sinogram, metal), np.float64))
    seen = np.zeros_like(sinogram) if air is None else _seen(scanner, sinogram, angles_rad, start, metal | trial, air)
    departures = sinogram - seen
    sizes = _sizes(known, departures - bridged_samples(departures, trial))
    errors = np.zeros((len(runs), HALF_WAVES, sinogram.shape[1]))
    for error, (_, first, length) in zip(errors, runs, strict=True):
        error[:, first : first + length] = length * sizes[:, None] * _half_waves(length)
    of_view = np.repeat([view for view, _, _ in runs], HALF_WAVES)
    rays = np.where(metal, seen + bridged_samples(departures, metal), sinogram)
    return RaysBehindMetal(rays, of_view, errors.reshape(-1, sinogram.shape[1]))


def _runs_beside(runs: list[Run], metal: NDArray[np.bool_]) -> list[Run]:
    """Return a run of known samples next to each run, on alternate sides, where there is one."""
    taken, beside = metal.copy(), []
    for view, start, length in runs:
        for side in (1, -1) if view % 2 else (-1, 1):
            first = start + side * AWAY * (length + 2)
            # A known sample stays at either end.
            if 0 < first < metal.shape[1] - length and not taken[view, first - 1 : first + length + 1].any():
                taken[view, first : first + length] = True
                beside.append((view, first, length))
                break
    return beside


def _sizes(known: list[Run], missed: FloatArray) -> FloatArray:
    """Return the amplitudes' standard deviations (half waves,) per sample of a run, from what known runs missed.

    An amplitude is proportional to a run's length. Where no known run is near metal, it may be anything.
    """
    if not known:
        return np.ones(HALF_WAVES)
    amplitudes = [
        2.0 / (length + 1) * _half_waves(length) @ missed[view, first : first + length] for view, first, length in known
    ]
    lengths = np.array([length for _, _, length in known])
    return np.asarray(np.sqrt(np.sum(np.square(amplitudes), axis=0) / np.sum(lengths**2)))


def _half_waves(length: int) -> FloatArray:
    """Return half waves over a run, (waves, length), which are 0 in the samples before and after it."""
    return np.sin(np.pi * np.outer(np.arange(1, HALF_WAVES + 1), np.arange(1, length + 1)) / (length + 1))


def _seen(
    scanner: Scanner,
    sinogram: FloatArray,
    angles_rad: FloatArray,
    start: SourceFrame,
    left_out: NDArray[np.bool_],
    air: AirFit,
) -> FloatArray:
    """Return all rays (views, detector) of an image of those that are not left out."""
    level = air.levels[:, None] + air.of_all_views
    lines = (bridged_samples(sinogram, left_out) - level).astype(np.float32)
    fan = fan_for_images(scanner, angles_rad, start)
    side_mm = 2.0 * object_radius_mm(fan, lines)
    with one_thread():
        projector = Projector(fan, ImageGrid(min(round(side_mm / PIXEL_MM), LARGEST_SIZE), side_mm))
        image = image_of_other_rays(projector, lines, np.where(left_out, np.inf, 0.0))
        return projector.forward(image).astype(np.float64) + level
