"""Image quality from slices of a plain disc, after the public description of ASTM E1695 (docs/do/image-quality.md)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError

# Ring's width, pixels; half the differentiated profile, in 10 to 90 % widths; the low MTF; frequencies to one listed.
BIN, REACH, LOW, FINER = 0.125, 3.0, 0.1, 30
# Pixels from the rim that may be on the wrong side of a circle, and the share of other pixels that may be. Smallest
# radius, pixels; half the side of the square that shows noise, in radii; fewest patches of a size.
RIM, MOST_WRONG, LEAST_RADIUS, MIDDLE, FEWEST, STANDARD_ERRORS = 2.0, 0.002, 24.0, 0.5, 100, 3.0


@dataclass(frozen=True)
class ImageQuality:
    """Modulation transfer function and contrast discrimination of slices of a disc."""

    radius_mm: float  # radius of the disc
    pixel_mm: float
    mtf_10_per_mm: float  # frequency at which the MTF falls to 10 %, cycles per mm
    frequencies_per_mm: tuple[float, ...]
    mtf: tuple[float, ...]  # at these frequencies
    patch_mm: tuple[float, ...]  # sides of square patches
    contrast_percent: tuple[float, ...]  # three standard deviations of their means, of the disc's density


def image_quality(volume: NDArray[np.float32], pixel_mm: float) -> ImageQuality:
    """Measure the MTF at the rim of a plain disc, and the contrast discrimination in its middle.

    Parameters
    ----------
    volume : (slices, x, y) float32
        Slices of one disc, in any unit; the profile of their mean is taken, the noise of each.
    pixel_mm : float
        Side of a pixel, mm.

    Raises
    ------
    GeometryError
        The slices show no plain disc.
    """
    image = volume.mean(axis=0, dtype=np.float64)
    labels, number = ndimage.label(image > 0.5 * np.median(image[image >= 0.5 * image.max()]))
    body = labels == 1 + np.argmax(np.bincount(labels.ravel(), minlength=2)[1:])
    mass = np.where(ndimage.binary_dilation(body, iterations=3), image, 0.0) if number else np.ones(image.shape)
    centre, radius = np.array(ndimage.center_of_mass(mass)), float(np.sqrt(body.sum() / np.pi))
    radii = np.hypot(*(np.indices(image.shape) - centre[:, np.newaxis, np.newaxis]))
    wrong = np.sum(((radii < radius) != body) & (np.abs(radii - radius) > RIM)) / max(body.sum(), 1)
    if radius < LEAST_RADIUS or wrong > MOST_WRONG:
        raise GeometryError(
            f"no plain disc is seen (radius {radius:.0f} pixels, {wrong:.1%} of its area differ): scan a solid disc, "
            f"{2 * LEAST_RADIUS:.0f} pixels wide or more; it shows how sharp and noisy images are, and cannot calibrate"
        )
    frequencies, mtf = _mtf(image, radii, radius)
    below = int(np.argmax(mtf < LOW))
    if not below:
        raise GeometryError(f"pixels of {pixel_mm:.3g} mm are too large for this MTF: ask for smaller ones (size)")
    sides, contrast = _contrast(volume, centre, radius)
    return ImageQuality(
        radius_mm=radius * pixel_mm,
        pixel_mm=pixel_mm,
        mtf_10_per_mm=float(frequencies[below]) / pixel_mm,
        frequencies_per_mm=tuple((frequencies[::FINER] / pixel_mm).tolist()),
        mtf=tuple(mtf[::FINER].tolist()),
        patch_mm=tuple(pixel_mm * side for side in sides),
        contrast_percent=tuple(contrast),
    )


def _mtf(image: FloatArray, radii: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return frequencies, cycles a pixel, and the MTF: the transform of the rim's differentiated profile."""
    last = int(0.9 * radius / BIN)
    bins = np.floor((radii - radius) / BIN).astype(int) + last
    near, at = (bins >= 0) & (bins < 2 * last), np.arange(2 * last)
    counts, sums = (np.bincount(bins[near], weights, minlength=2 * last) for weights in (None, image[near]))
    profile = np.interp(at, at[counts > 0], sums[counts > 0] / counts[counts > 0])
    inside, outside = np.median(profile[: last // 2]), np.median(profile[-last // 2 :])
    share = (profile - outside) / (inside - outside)
    middle = int(np.argmax(share < 0.5))
    width = int(np.argmax(share[middle:] < 0.1)) + int(np.argmax(share[middle::-1] > 0.9))
    reach = int(min(REACH * max(width, 1.0 / BIN), last // 2))
    spread = -np.diff(share[middle - reach : middle + reach + 1])
    frequencies = np.linspace(0.0, 0.75, 100 * FINER + 1)
    phases = np.exp(-2j * np.pi * BIN * np.outer(frequencies, np.arange(spread.size)))
    transform = np.abs(phases @ spread) / np.sinc(BIN * frequencies) ** 2
    return frequencies, transform / transform[0]


def _contrast(volume: NDArray[np.float32], centre: FloatArray, radius: float) -> tuple[list[int], list[float]]:
    """Return sides of patches, pixels, and the contrast discrimination of each, per cent; a bowl is no contrast."""
    half, (x, y) = int(MIDDLE * radius), np.rint(centre).astype(int)
    square = volume[:, x - half : x + half, y - half : y + half].astype(np.float64)
    places = np.indices(square.shape[1:]).reshape(2, -1) - half
    bowl = np.stack([np.ones(places.shape[1]), *places, np.square(places).sum(axis=0)], axis=1)
    trend = bowl @ np.linalg.lstsq(bowl, square.mean(axis=0).ravel(), rcond=None)[0]
    noise = square - trend.reshape(square.shape[1:])
    sides = [side for side in range(1, half) if (2 * half // side) ** 2 >= FEWEST]
    deviations = []
    for side in sides:
        number = 2 * half // side
        patches = noise[:, : number * side, : number * side].reshape(-1, number, side, number, side).mean(axis=(2, 4))
        deviations.append(float(np.sqrt(patches.var(axis=(1, 2), ddof=1).mean()) / square.mean()))
    return sides, [100.0 * STANDARD_ERRORS * deviation for deviation in deviations]
