"""Metal in a log: nails, screws and fragments, found in a first image and removed from the sinogram.

Rays through metal are starved and hardened: filtering them draws streaks over the whole slice. They are interpolated
along the detector from neighbouring rays (linear interpolation of projections: Kalender, Hebel and Ebersberger 1987,
Radiology 164, 576), or left out by methods that do not need them.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, all_round
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.bridging import bridged_samples

INTERPOLATION = "linear interpolation of projections (Kalender, Hebel and Ebersberger 1987)"
WITHOUT_RAYS = "no weight for rays through metal (metal found as by Kalender, Hebel and Ebersberger 1987)"

# The constants of this file were measured with benchmarks/log_metal.py.
# Metal attenuates this number of times more than the wood, in an image as sharp as the detector. Knots, edges, noise
# and the streaks of wood from 12 views stay below 4.
TIMES_WOOD = 6.0
# A piece of metal is the set of pixels above this share of the largest value within this number of millimetres.
SHARE_OF_PEAK, PEAK_REACH_MM = 0.35, 8.0
# The streaks of metal are weaker than this share of its largest value; pieces as weak as streaks are found after the
# stronger ones have been removed.
SHARE_OF_LARGEST, ROUNDS = 0.5, 8
# Views of the coarse image that shows whether there is metal at all.
COARSE_VIEWS = 45
# Pixels of the first image along each side.
SMALLEST_SIZE, LARGEST_SIZE = 16, 512
# Cells next to the shadow of metal that are interpolated too.
MARGIN = 2


@dataclass(frozen=True, eq=False)
class LogMetal:
    """The metal of one slice.

    Attributes
    ----------
    trace : (views, cells) bool
        Samples whose rays cross metal, with a margin.
    filled : (views, cells) float32
        The sinogram with those samples interpolated: the log without its metal.
    grid : ImageGrid
    excess : (size, size) float32
        Attenuation above the wood's, 0 where there is no metal.
    """

    trace: NDArray[np.bool_]
    filled: Image
    grid: ImageGrid
    excess: Image

    def on(self, grid: ImageGrid) -> Image:
        """Return the excess as the mean over each pixel of another grid, (size, size)."""
        x, y = (_overlaps(self.grid, grid, axis) for axis in (0, 1))
        return np.asarray(x @ self.excess @ y.T, np.float32)


@dataclass(frozen=True)
class MetalSearch:
    """The search for metal in an image of the whole log, with pixels as fine as the detector's cells.

    Attributes
    ----------
    fine, coarse : Projector
        Projectors of all views, and of every `step`-th view.
    """

    fine: Projector
    coarse: Projector
    step: int

    @classmethod
    def of(cls, geometry: FanBeamGeometry, radius_mm: float) -> "MetalSearch | None":
        """Search the disc of a radius around the COR; None if the views do not cover a full turn or show nothing."""
        frame, step = geometry.frame, max(1, geometry.angles_rad.size // COARSE_VIEWS)
        few = geometry.with_angles(geometry.angles_rad[::step])
        # A field whose corners reach the source has no rays.
        radius = min(radius_mm, 0.7 * frame.source_distance_mm * math.cos(frame.tilt_rad))
        if radius <= 0.0 or not (all_round(geometry.angles_rad) and all_round(few.angles_rad)):
            return None
        size = math.ceil(2.0 * radius * frame.magnification / geometry.scanner.detector_pitch_mm)
        grid = ImageGrid(min(max(size, SMALLEST_SIZE), LARGEST_SIZE), 2.0 * radius)
        return cls(Projector(geometry, grid), Projector(few, grid), step)

    def suspects(self, lines: Image) -> NDArray[np.bool_]:
        """Return which slices of a block (slices, views, detector) show metal in a coarse image."""
        few = lines[:, :: self.step]
        # A single slice is computed faster than as a block.
        images = fbp(self.coarse, few).image if len(few) > 1 else fbp(self.coarse, few[0]).image[None]
        suspected: NDArray[np.bool_] = images.max(axis=(1, 2)) > TIMES_WOOD * np.array(
            [_wood(image) for image in images]
        )
        return suspected

    def find(self, sinogram: Image) -> LogMetal | None:
        """Find the metal of a slice (views, detector); None if there is no metal.

        The strongest pieces come first: the image without them shows weaker pieces.
        """
        metal = np.zeros((self.fine.grid.size,) * 2, bool)
        trace, filled = np.zeros(sinogram.shape, bool), sinogram
        for _ in range(ROUNDS):
            pieces = self._pieces(fbp(self.fine, filled).image) & ~metal
            if not pieces.any():
                break
            metal |= pieces
            shadow = self.fine.forward(metal) > 0.0
            trace = scipy.ndimage.binary_dilation(shadow, np.ones((1, 2 * MARGIN + 1), bool))
            filled = np.asarray(bridged_samples(sinogram, trace), np.float32)
        if not metal.any():
            return None
        return LogMetal(trace, filled, self.fine.grid, self._excess(metal, sinogram - filled))

    def _pieces(self, image: Image) -> NDArray[np.bool_]:
        near = scipy.ndimage.maximum_filter(image, 2 * round(PEAK_REACH_MM / self.fine.grid.pixel_mm) + 1)
        beyond_wood = TIMES_WOOD * _wood(image)
        least = max(beyond_wood, SHARE_OF_LARGEST * float(image.max()))
        strong = image > np.maximum(SHARE_OF_PEAK * near, beyond_wood)
        pieces, count = scipy.ndimage.label(strong)
        keep = np.zeros(count + 1, bool)
        keep[pieces[image > least]] = True
        keep[0] = False
        strongest: NDArray[np.bool_] = keep[pieces]
        return strongest

    def _excess(self, metal: NDArray[np.bool_], samples: Image) -> Image:
        """Estimate the metal's attenuation above the wood's by least squares of the samples above interpolated ones.

        All pieces get one value: few views determine no more.
        """
        lengths = self.fine.forward(metal).ravel().astype(np.float64)
        value = max(float(lengths @ samples.ravel()) / float(lengths @ lengths), 0.0)
        return np.where(metal, np.float32(value), np.float32(0.0))


def _wood(image: Image) -> float:
    """Return the attenuation of the wood: the median of pixels that are not air."""
    values = image[::3, ::3]
    return float(np.median(values[values >= 0.5 * np.quantile(values, 0.9)]))


def _overlaps(source: ImageGrid, target: ImageGrid, axis: int) -> FloatArray:
    """Return shares of the source's pixels in each of the target's along an axis, (target size, source size)."""
    source_ends, target_ends = (
        grid.low_mm[axis] + np.arange(grid.size + 1, dtype=np.float64) * grid.pixel_mm for grid in (source, target)
    )
    common = np.minimum(source_ends[1:], target_ends[1:, None]) - np.maximum(source_ends[:-1], target_ends[:-1, None])
    shares: FloatArray = np.maximum(common, 0.0) / target.pixel_mm
    return shares
