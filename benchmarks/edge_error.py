"""How far the outlines of an image are off."""

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from sawmill_tomography.geometry.geometry import FloatArray

# An edge farther away than this number of pixels is another edge.
REACH_PIXELS = 5
# An edge is clear of other edges if the truth itself shows it within this distance of its place.
CLEAR_PIXELS = 0.5


def edge_error_mm(image: ArrayLike, truth: ArrayLike, pixel_mm: float, *, contrast: float = 0.1) -> float:
    """Measure the distance of an image's outlines from the truth's, in mm: knots, metal fragments, the bark.

    The truth's strong edges are the steps between its levels by more than `contrast` times its range. At each edge, the
    image is sampled along the edge's normal; the displacement is the position of the best fitting step between the
    truth's two levels: at most REACH_PIXELS, which also counts for an edge that is missing. The result is the root mean
    square of the displacements over the edges that are clear of other edges; 0 where the truth has no such edge.

    `image`, `truth` (size, size): images [x, y], in the same unit.
    """
    reference = np.asarray(truth, np.float64)
    points, normals, low, high = _edges(reference, contrast)
    if len(points) == 0:
        return 0.0
    # Near another edge, even the truth's own profile does not show this edge in its place.
    clear = np.abs(_displacements(reference, points, normals, low, high)) <= CLEAR_PIXELS
    if not clear.any():
        return 0.0
    displacements = _displacements(
        np.asarray(image, np.float64), points[clear], normals[clear], low[clear], high[clear]
    )
    return float(pixel_mm * np.sqrt(np.mean(displacements**2)))


def _displacements(
    image: FloatArray, points: FloatArray, normals: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the position along each normal where the step from low to high fits the image best, in pixels."""
    along = np.linspace(-REACH_PIXELS, REACH_PIXELS, 16 * REACH_PIXELS + 1)
    sampled = points[:, :, None] + normals[:, :, None] * along
    profile = scipy.ndimage.map_coordinates(image, np.moveaxis(sampled, 1, 0), order=1, mode="nearest")
    # Cost of counting a sample as low rather than high, summed up to each place where the step may be.
    cost = np.cumsum((profile - low[:, None]) ** 2 - (profile - high[:, None]) ** 2, axis=1)
    displaced: FloatArray = along[np.argmin(cost, axis=1)]
    return displaced


def _edges(truth: NDArray[np.float64], contrast: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the truth's strong edges: points (edges, 2) in pixels, normals uphill (edges, 2), levels of both sides."""
    smooth = scipy.ndimage.gaussian_filter(truth, 1.0)
    gradient = np.stack(list(np.gradient(smooth)), axis=-1)
    steepness = np.linalg.norm(gradient, axis=-1)
    inside = np.zeros(truth.shape, bool)
    inside[REACH_PIXELS:-REACH_PIXELS, REACH_PIXELS:-REACH_PIXELS] = True
    candidates = np.argwhere(inside & (steepness > 0.2 * contrast * np.ptp(truth)))
    normals = gradient[tuple(candidates.T)] / steepness[tuple(candidates.T)][:, None]

    def read(values: NDArray[np.float64], offset: float) -> FloatArray:
        where = candidates + offset * normals
        return np.asarray(scipy.ndimage.map_coordinates(values, where.T, order=1, mode="nearest"), np.float64)

    # Edges are where the slope is steepest along its own direction, between levels two pixels to either side.
    crest = (read(steepness, 0.0) >= read(steepness, -1.0)) & (read(steepness, 0.0) >= read(steepness, 1.0))
    low, high = read(truth, -2.0), read(truth, 2.0)
    strong = crest & (high - low > contrast * np.ptp(truth))
    along = np.linspace(-1.5, 1.5, 25)
    points, turned, low, high = candidates[strong].astype(np.float64), normals[strong], low[strong], high[strong]
    # The crest is known to a pixel; the edge itself is where the truth crosses the middle level.
    where = points[:, :, None] + turned[:, :, None] * along
    profile = scipy.ndimage.map_coordinates(truth, np.moveaxis(where, 1, 0), order=1, mode="nearest")
    nearest = np.abs(profile - 0.5 * (low + high)[:, None]).argmin(axis=1)
    return points + along[nearest][:, None] * turned, turned, low, high
