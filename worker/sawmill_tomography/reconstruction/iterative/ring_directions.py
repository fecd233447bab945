"""Directions across growth rings, from images of a log: circles between the pith and the outline, and the image's own.

Where the image shows edges in other directions (knots, cracks, bark), its structure tensor outweighs the circles.
"""

import numpy as np
import scipy

from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.reconstruction.iterative import _ring_numba as kernels
from sawmill_tomography.reconstruction.iterative.descent import Floats, Images

# The constants of this file were found on a CT slice of a tree and on simulated logs (benchmarks/tree_disc.py).
# Standard deviations in mm of the smoothing before a gradient is taken, and of the structure tensor's window.
GRADIENT_MM, WINDOW_MM = 1.0, 3.0
# Least smoothing before a gradient, in pixels.
GRADIENT_PIXELS = 0.7
# Gradient, in typical attenuations per smoothing length, from which the image's direction outweighs the circles', and
# from which a pixel counts when the pith is sought.
CIRCLES, COUNTS = 0.1, 0.01
# Attenuation of the outline, in typical attenuations, and the bark's thickness, which shows no rings.
OUTLINE, BARK_MM = 0.3, 5.0
# Candidates for the pith's place on either side of the outline's centre, in radii, their distance, and the standard
# deviation of the places that a log may have: knots alone may point elsewhere.
REACH, STEP, USUAL_REACH = 0.5, 0.1, 0.7
# Sine of the angle between gradient and normal that counts half.
WIDTH = 0.15
# Every second row and column of pixels is enough to seek the pith.
EVERY = 2
# Slices on either side along the log that the pith is sought in together.
PITH_SLICES = 2


def ring_directions(images: Images, grid: ImageGrid, typical: Floats, joined: Floats) -> Images:
    """Return unit vectors across the rings or other structures of each image, (slices, 2, n, n) float32, along x and y.

    Parameters
    ----------
    images : (slices, n, n) float32
    grid : ImageGrid
        Grid of the images.
    typical : (slices,) float
        Typical attenuation of each slice.
    joined : (slices - 1,) float
        Not 0 between slices that are neighbours along the log: the pith runs smoothly there.
    """
    relative, low = images / np.asarray(typical, np.float32)[:, None, None], np.asarray(grid.low_mm, np.float64)
    slopes = _slopes(relative, grid)
    centres, radii, inside = outlines(relative, grid)
    piths = _piths(slopes, inside, grid, centres, radii, joined)
    out = np.empty_like(slopes)
    kernels.directions(_structure(slopes, grid), low, grid.pixel_mm, centres, radii, piths, CIRCLES**2, out)
    return out


def edge_directions(images: Images, grid: ImageGrid, typical: Floats) -> Images:
    """Return what `ring_directions` does without the circles: vectors whose length falls to 0 where no edge is."""
    relative = images / np.asarray(typical, np.float32)[:, None, None]
    xx, xy, yy = _structure(_slopes(relative, grid), grid).swapaxes(0, 1)
    strength, angle = np.hypot(xx - yy, 2.0 * xy), 0.5 * np.arctan2(2.0 * xy, xx - yy)
    vectors: Images = np.sqrt(strength / (strength + CIRCLES**2)) * np.stack([np.cos(angle), np.sin(angle)])
    return np.ascontiguousarray(vectors.swapaxes(0, 1), np.float32)


def enlarged(directions: Images, size: int) -> Images:
    """Return directions (slices, 2, n, n) for images of this size, a multiple of n."""
    times = size // directions.shape[-1]
    return directions if times == 1 else np.repeat(np.repeat(directions, times, axis=2), times, axis=3)


def halved(images: Images) -> Images:
    """Return images (slices, n, n) of an even size with pixels of twice the size."""
    slices, n, _ = images.shape
    return np.asarray(images.reshape(slices, n // 2, 2, n // 2, 2).mean(axis=(2, 4)))


def outlines(relative: Images, grid: ImageGrid) -> tuple[Floats, Floats, Images]:
    """Return the outlines' centres (slices, 2) and radii (slices,) in mm, and the wood within the bark as 0 or 1.

    `relative` (slices, n, n): images in typical attenuations.
    """
    body = relative > OUTLINE
    area = np.maximum(body.sum(axis=(1, 2)), 1)
    middles = (np.arange(grid.size) + 0.5) * grid.pixel_mm
    x, y = (body.sum(axis=axis) @ middles / area for axis in (2, 1))
    radii = np.maximum(np.sqrt(area / np.pi), 1.0) * grid.pixel_mm
    bark = 2 * round(BARK_MM / grid.pixel_mm) + 1
    inside = scipy.ndimage.minimum_filter(body.astype(np.uint8), (0, bark, bark)) if bark > 1 else body
    return np.stack([x, y], axis=1) + np.asarray(grid.low_mm), radii, np.asarray(inside, np.float32)


def _slopes(relative: Images, grid: ImageGrid) -> Images:
    """Return the gradients along x and y in typical attenuations per smoothing length, (slices, 2, n, n)."""
    smoothing = max(GRADIENT_MM / grid.pixel_mm, GRADIENT_PIXELS)
    widths = (0.0, smoothing, smoothing)
    slopes = [scipy.ndimage.gaussian_filter(relative, widths, order=(0, *order)) for order in ((1, 0), (0, 1))]
    return np.asarray(np.float32(smoothing) * np.stack(slopes, axis=1))


def _structure(slopes: Images, grid: ImageGrid) -> Images:
    """Return the structure tensor xx, xy, yy, (slices, 3, n, n)."""
    products: Images = np.stack([slopes[:, 0] ** 2, slopes[:, 0] * slopes[:, 1], slopes[:, 1] ** 2], axis=1)
    window = WINDOW_MM / grid.pixel_mm
    return np.asarray(scipy.ndimage.gaussian_filter(products, (0.0, 0.0, window, window), truncate=3.0))


def _piths(slopes: Images, inside: Images, grid: ImageGrid, centres: Floats, radii: Floats, joined: Floats) -> Floats:
    """Return the pith's place from the outline's centre, in radii (slices, 2), that most gradients agree on."""
    slopes = np.ascontiguousarray(slopes[..., ::EVERY, ::EVERY])
    square = np.square(slopes).sum(axis=1)
    weights = inside[:, ::EVERY, ::EVERY] * square / (square + np.float32(COUNTS**2))
    across = slopes / np.sqrt(square + np.float32(1e-12))[:, None]
    side = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
    shifts = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    scores = np.empty((len(slopes), len(shifts)))
    low = np.asarray(grid.low_mm) - 0.5 * (EVERY - 1) * grid.pixel_mm
    kernels.score(across, weights, low, EVERY * grid.pixel_mm, centres, radii, shifts, WIDTH, scores)
    usual = np.exp(-0.5 * np.square(shifts / USUAL_REACH).sum(axis=1)).reshape(side.size, side.size)
    piths = np.empty((len(slopes), 2))
    for k, of_slice in enumerate(_along_the_log(scores, joined).reshape(-1, side.size, side.size)):
        # From the highest score that is not on the border.
        i, j = divmod(int(np.argmax((of_slice * usual)[1:-1, 1:-1])), side.size - 2)
        i, j = _top(of_slice, (i + 1, j + 1))
        piths[k] = _peak(of_slice[i - 1 : i + 2, j], side[i]), _peak(of_slice[i, j - 1 : j + 2], side[j])
    return piths


def _top(scores: Floats, start: tuple[int, int]) -> tuple[int, int]:
    """Climb from a place to the nearest peak of the scores, not on the border."""
    i, j = start
    while True:
        a, b = divmod(int(np.argmax(scores[i - 1 : i + 2, j - 1 : j + 2])), 3)
        up = min(max(i + a - 1, 1), len(scores) - 2), min(max(j + b - 1, 1), len(scores) - 2)
        if up == (i, j) or scores[up] <= scores[i, j]:
            return i, j
        i, j = up


def _along_the_log(scores: Floats, joined: Floats) -> Floats:
    """Add the scores of the neighbours up to `PITH_SLICES` away along the log."""
    log = np.append(0, np.cumsum(joined == 0.0))
    number = np.arange(len(scores))
    near = (np.abs(number[:, None] - number) <= PITH_SLICES) & (log[:, None] == log)
    return np.asarray(near.astype(np.float64) @ scores)


def _peak(three: Floats, middle: float) -> float:
    """Return the place of the parabola's maximum through three scores around the middle one."""
    before, at, after = three
    bend = before - 2.0 * at + after
    return middle if bend >= 0.0 else middle + STEP * float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
