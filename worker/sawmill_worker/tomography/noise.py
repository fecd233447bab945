"""How noisy a sinogram is, and how well an image explains it."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d

from sawmill_worker.tomography.air import find_air
from sawmill_worker.tomography.geometry import FloatArray, GeometryError
from sawmill_worker.tomography.projector import Image, Projector

# No scan is better than this share of its RMS once pixels stand for a log: noise-free data are taken to be so noisy.
LEAST_SHARE = 0.002
# Cells over which a line integral is averaged to know its noise.
SMOOTHED = 9
# Noise alone gives 1, pixels up to 1.3 in the published log's case; a tape's errors of theta give 3 and more.
MISFIT_OF_A_GOOD_FIT = 2.0
# FBP does not fit the data. From so many views and with the right geometry, filter and pixels leave at most 9 % of them
# (phantoms and logs, frequency scaling from 0.05, 16 to 2048 pixels), and it turns noise into at most 3.7 times itself.
# Rays that are off by 8 mm leave 13 to 17 %. From 20 views a right and a wrong geometry leave as much as each other.
FBP_VIEWS, FBP_SHARE, FBP_NOISE = 90, 0.1, 4.0


def estimated_noise(sinogram: NDArray[np.float32]) -> float:
    """Standard deviation of one sample of a sinogram (views, detector), in its unit.

    From the air beside the object; where the object covers the detector, from second differences along it, whose
    median magnitude ignores edges.
    """
    air = find_air(sinogram)
    if air is not None:
        noise = air.noise
    else:
        second = np.diff(sinogram, 2, axis=-1)
        noise = 1.4826 * float(np.median(np.abs(second))) / math.sqrt(6.0)
    return max(noise, LEAST_SHARE * float(np.sqrt(np.mean(np.square(sinogram, dtype=np.float64)))), 1e-30)


def photon_noise(sinogram: ArrayLike, air_counts: ArrayLike) -> FloatArray:
    """Standard deviation of each line integral p measured with N0 counts in air: sqrt(exp(p) / N0).

    From var N = N0 exp(-p) and p = -ln(N / N0). p is averaged over SMOOTHED neighbouring cells first: a ray must not
    count more because its own noise made it brighter, which would bias the image.

    Parameters
    ----------
    sinogram : (..., detector) float
        Line integrals, dimensionless.
    air_counts : float or array that broadcasts with it
    """
    counts = np.asarray(air_counts, np.float64)
    if not (counts > 0.0).all():
        raise GeometryError(f"air_counts must be positive counts, not {counts.min():g}")
    smooth = uniform_filter1d(np.asarray(sinogram, np.float64), SMOOTHED, axis=-1, mode="nearest")
    return np.exp(0.5 * np.clip(smooth, 0.0, None)) / np.sqrt(counts)


def noise_of_each_ray(noise: ArrayLike | None, lines: Image) -> FloatArray:
    """The noise as (slices, views, detector), estimated slice by slice where it is None.

    Raises
    ------
    GeometryError
        If a given noise does not fit the block or is not positive.
    """
    if noise is None:
        return np.array([estimated_noise(line) for line in lines]).reshape(-1, 1, 1)
    given = np.asarray(noise, np.float64)
    if not (np.isfinite(given).all() and (given > 0.0).all()):
        raise GeometryError("the noise must be a positive standard deviation, one number or one for each ray")
    try:
        np.broadcast_shapes(given.shape, lines.shape)
    except ValueError:
        raise GeometryError(
            f"the noise has shape {given.shape}; it must be one number or (views, detector) = {lines.shape[1:]}"
        ) from None
    return given.reshape((1,) * (3 - given.ndim) + given.shape)


def data_misfit(projector: Projector, images: Image, lines: Image, noise: FloatArray) -> FloatArray:
    """Root mean square of (A x - y) / noise over the rays that cross the field, (slices,).

    1 means explained to the noise; pixels of finite size add a little. To methods that fit the data a wrong geometry
    shows as a misfit far above 1.
    """
    relative = (projector.forward(images) - lines) / noise
    misfit: FloatArray = np.sqrt(np.mean(relative[:, projector.crossing] ** 2, axis=-1))
    return misfit


def remarks_on(misfit: FloatArray, lines: Image, noise: FloatArray) -> tuple[str, ...]:
    """What a user should know of the data and the fit."""
    remarks = []
    worst = float(misfit.max())
    if worst > MISFIT_OF_A_GOOD_FIT:
        remarks.append(
            f"the image misses the data by {worst:.2g} times their noise: check the geometry, or whether the object "
            "moved during the scan or lies partly outside the field"
        )
    air = find_air(lines[len(lines) // 2])
    if air is not None:
        level, scatter = air.background, float(np.sqrt(np.mean(noise**2)))
        if abs(level) > 0.5 * scatter and abs(level) > 5.0 * scatter / math.sqrt(air.level.size * int(air.cells.sum())):
            remarks.append(f"the air stands at {level:.3g}, not at 0: take the background out first")
    return tuple(remarks)


def remark_on_filtered(misfit: float, line: NDArray[np.float32], noise: float) -> str | None:
    """What a user should know of the misfit of an FBP; None where it says nothing of the geometry.

    Parameters
    ----------
    misfit : float
        Of the slice, against the noise.
    line : (views, detector) float32
        Its line integrals.
    noise : float
        Standard deviation of a line integral.
    """
    missed, size = misfit * noise, float(np.sqrt(np.mean(np.square(line, dtype=np.float64))))
    if len(line) < FBP_VIEWS or misfit < FBP_NOISE or missed < FBP_SHARE * size:
        return None
    return (
        f"the image misses the data by more than {FBP_SHARE:.0%} of them and {FBP_NOISE:.0f} times their noise, which "
        "filtering alone does not: check the geometry, or whether the object moved during the scan"
    )
