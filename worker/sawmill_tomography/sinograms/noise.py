"""The noise of a sinogram, and the misfit of an image to it."""

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.scattered_radiation import STEEPEST, measured_and_slope, with_scatter
from sawmill_tomography.statistics import few_with_most, noise_of_differences
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.messages import Reason, numbered
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection

# Lower bound of the noise as a share of the data's RMS, for noise-free data: pixels approximate a log no better.
LEAST_SHARE = 0.002
# Cells over which a line integral is averaged to estimate its noise.
SMOOTHED = 9
# Noise alone gives 1, pixels up to 1.3 for the published log; errors of theta like a measuring tape's give 3 and more
# (tests/tomography/test_cauchy_map.py, tests/calibration/test_methods.py).
MISFIT_OF_A_GOOD_FIT = 2.0
# Shifts of the views explain more than half of the residual beyond noise where the geometry is wrong or the object
# moved, and less than a third where hardening, scatter or blur alone are the cause
# (tests/calibration/test_misfit.py).
DISPLACED = 0.4
# Views are to blame where this share of them holds most of the residual's power, each with this multiple of the median
# view's (tests/calibration/test_misfit.py).
FEW_VIEWS, ALL_OVER = 0.1, 4.0


def estimated_noise(sinogram: NDArray[np.float32]) -> float:
    """Estimate the standard deviation of one sample of a sinogram (views, detector), in its unit.

    The estimate comes from the air next to the object; if the object covers the detector, from second differences along
    the detector, whose median magnitude is insensitive to edges.
    """
    air = find_air(sinogram)
    noise = noise_of_differences(np.diff(sinogram, 2, axis=-1), 2) if air is None else air.noise
    return max(noise, LEAST_SHARE * float(np.sqrt(np.mean(np.square(sinogram, dtype=np.float64)))), 1e-30)


def photon_noise(sinogram: ArrayLike, air_counts: ArrayLike, *, smoothed: int = SMOOTHED) -> FloatArray:
    """Return the standard deviation of each line integral p measured with N0 counts in air: sqrt(exp(p) / N0).

    It follows from var N = N0 exp(-p) and p = -ln(N / N0). p is averaged over neighbouring cells first: a ray must not
    count more because its own noise made it brighter, which would bias the image.

    `sinogram` (..., detector) float: line integrals, dimensionless.
    """
    counts = np.asarray(air_counts, np.float64)
    if not (counts > 0.0).all():
        raise GeometryError(f"air_counts must be positive counts, not {counts.min():g}")
    return np.exp(0.5 * np.clip(_smooth(sinogram, smoothed), 0.0, None)) / np.sqrt(counts)


def _smooth(sinogram: ArrayLike, cells: int = SMOOTHED) -> FloatArray:
    return np.asarray(scipy.ndimage.uniform_filter1d(np.asarray(sinogram, np.float64), cells, axis=-1, mode="nearest"))


def noise_of_rays(
    lines: Image, *, counts: bool, beam: BeamCorrection = NOTHING_FOUND, uncertainty: NDArray[np.floating] | None = None
) -> FloatArray:
    """Estimate noise from air and, for counts, photons: (slices, 1, 1), or for each ray (slices, views, detector).

    Parameters
    ----------
    lines : (slices, views, detector) float32
        Line integrals whose air is at 0.
    counts : bool
        True if the line integrals were made from counts; the air's scatter then gives the photons, whatever the unit.
    beam : BeamCorrection, optional
        Correction made to the line integrals: it has multiplied their noise by its slope.
    uncertainty : (slices, views, detector), optional
        Further standard deviation of each ray; infinite for rays without weight.
    """
    air = noise_of_each_ray(None, lines)
    measured: FloatArray = np.asarray(lines, np.float64) if beam == NOTHING_FOUND else _smooth(lines)
    slope = np.ones(())
    if beam.hardening is not None:
        measured, slope = measured_and_slope(beam.hardening, measured)
    if beam.scatter is not None:
        primary, measured = measured, with_scatter(beam.scatter, measured)
        slope = slope * np.minimum(np.exp(primary - measured), STEEPEST)
    noise = (photon_noise(measured, 1.0 / air**2) if counts else air) * slope
    return noise if uncertainty is None else np.hypot(noise, uncertainty)


def rms_noise(noise: FloatArray) -> float:
    """Return the root mean square of the noise of the rays that are not left out."""
    return float(np.sqrt(np.mean(noise[np.isfinite(noise)] ** 2)))


def noise_of_each_ray(noise: ArrayLike | None, lines: Image) -> FloatArray:
    """Return the noise as (slices, views, detector), estimated slice by slice if `noise` is None."""
    if noise is None:
        return np.array([estimated_noise(line) for line in lines]).reshape(-1, 1, 1)
    noises = np.asarray(noise, np.float64)
    if not ((noises > 0.0).all() and np.isfinite(noises).any()):
        raise GeometryError("the noise must be a positive standard deviation, one number or one for each ray")
    try:
        np.broadcast_shapes(noises.shape, lines.shape)
    except ValueError:
        raise GeometryError(
            f"the noise has shape {noises.shape}; it must be one number or (views, detector) = {lines.shape[1:]}"
        ) from None
    return noises.reshape((1,) * (3 - noises.ndim) + noises.shape)


def data_misfit(projector: Projector, images: Image, lines: Image, noise: FloatArray) -> FloatArray:
    """Return the RMS of (A x - y) / noise over the rays that cross the field and are not left out, (slices,).

    1 means that the data are explained to their noise; pixels of finite size add a little. For methods that fit the
    data, a wrong geometry gives a misfit far above 1.
    """
    counted = (noise <= np.finfo(np.float32).max) & projector.crossing
    relative = (projector.forward(images) - lines) / np.where(counted, noise, math.inf).astype(np.float32)
    return np.asarray(np.sqrt(np.einsum("skm,skm->s", relative, relative, dtype=np.float64) / counted.sum(axis=(1, 2))))


def misfit_cause(projector: Projector, image: Image, line: Image, noise: FloatArray, *, displaced: float) -> Reason:
    """Name what a large misfit comes from: few views, shifts of the views, or neither; with the share they explain.

    A wrong geometry and a moving object shift the views against each other. Hardening, blur and scatter do not: they
    change every view in its place. A wrong order of the views need not.

    `image` (size, size) float32. `line`, `noise` (views, detector).
    """
    counted = np.isfinite(noise) & projector.crossing
    weight = np.where(counted, 1.0 / noise, 0.0)
    model = projector.forward(image[None])[0].astype(np.float64)
    missed, shift = (line - model) * weight, np.gradient(model, axis=1) * weight
    samples, of_view, of_shift = int(counted.sum()), np.sum(missed**2, axis=1), np.sum(shift**2, axis=1)
    power = float(of_view.sum())
    worst = few_with_most(of_view, FEW_VIEWS, ALL_OVER)
    if worst.size:
        percent = 100.0 * float(of_view[worst].sum()) / power
        return ImageMessage.IN_FEW_VIEWS(percent=percent, views=numbered(worst.tolist()))
    seen = of_shift > 0.0
    explained = float(np.sum(np.sum(missed * shift, axis=1)[seen] ** 2 / of_shift[seen])) - seen.sum() * power / samples
    share = explained / max(power - samples, 1e-30)
    message = ImageMessage.DISPLACED if share > displaced else ImageMessage.NOT_DISPLACED
    return message(percent=100.0 * max(share, 0.0))


def remarks_on(
    projector: Projector, images: Image, misfit: FloatArray, lines: Image, noise: FloatArray
) -> tuple[Reason, ...]:
    """Return remarks on the data and the fit for the user."""
    remarks: list[Reason] = []
    worst = int(misfit.argmax())
    if misfit[worst] > MISFIT_OF_A_GOOD_FIT:
        of_worst = np.broadcast_to(noise, lines.shape)[worst]
        cause = misfit_cause(projector, images[worst], lines[worst], of_worst, displaced=DISPLACED)
        remarks.append(ImageMessage.MISSES_DATA(cause, times=float(misfit[worst])))
    air = find_air(lines[len(lines) // 2])
    if air is not None:
        level, scatter = air.background, rms_noise(noise)
        if abs(level) > 0.5 * scatter and abs(level) > 5.0 * scatter / math.sqrt(air.level.size * int(air.cells.sum())):
            remarks.append(ImageMessage.AIR_NOT_AT_ZERO(level=level))
    return tuple(remarks)
