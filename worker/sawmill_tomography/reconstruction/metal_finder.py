"""Metal in a phantom or a log: bodies that shadows show, in most views, as much denser than wood.

Shadows are what line integrals have beyond the wood: of a phantom the residual of its fit, of a log what is narrower
than wood can be, or departs from an image of the other rays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector

# Measured: benchmarks/log_metal.py and, for phantoms, benchmarks/metal.py at 3ab7f653.
# Fewer views do not show a body by its shadows. Every second of twice as many views as MOST_VIEWS makes the image, and
# so on: 10 ms of processor time for a slice with knots, 1 ms for one without narrow shadows.
FEWEST_VIEWS, MOST_VIEWS = 8, 24
# Pixels of the image: their side, and their number along each side.
PIXEL_MM, SMALLEST_SIZE, LARGEST_SIZE = 2.0, 16, 512
# A shadow attenuates by as much as LEAST_WOOD_MM of wood, and by LEAST_NOISE standard deviations of a sample.
LEAST_WOOD_MM, LEAST_NOISE = 5.0, 3.0
# A body has a shadow in more than this share of the views. Knots and rings on its rays hide it in some of them.
SHARE_OF_VIEWS = 0.4
# LATER_ITERATIONS start from metal found before, and elsewhere from ALSO_SHARE of its mean.
ITERATIONS, LATER_ITERATIONS, ALSO_SHARE = 12, 40, 0.1
# THICK times as much is in the shadow of a body, whatever lies next to it.
THICK = 4.0
# Metal attenuates TIMES_WOOD times more than the wood around it, and a piece as much as LEAST_PIECE_MM2 of wood. Wood
# alone makes pieces of 30 mm² at most; a nail of 3.2 mm across the slice, 6 times as dense as the wood, one of 55. What
# attenuates less than SHARE_OF_PEAK of a piece's largest attenuation is its blurred border.
TIMES_WOOD, LEAST_PIECE_MM2, SHARE_OF_PEAK = 3.5, 50.0, 0.3
# Cells next to the shadow of metal that are left out too.
MARGIN = 1

ALONG_DETECTOR = np.ones((1, 2 * MARGIN + 1), bool)


@dataclass(frozen=True, eq=False)
class Shadows:
    """The shadows of metal in a sinogram."""

    excess: Image  # (views, cells) float32: what the metal adds to the line integrals of the wood, as far as known
    least: float  # the excess of thin wood, or of noise
    wood_per_mm: float  # mean attenuation of the wood

    @property
    def dark(self) -> NDArray[np.bool_]:
        """True where the excess is more than `least`, (views, cells)."""
        return self.excess > self.least

    def by_departures(self, departures: Image) -> "Shadows":
        """Return the shadows, of any width, with the departures (views, cells) from the line integrals of the wood."""
        return replace(self, excess=np.maximum(smoothed(departures), 0.0))


@dataclass(frozen=True)
class MetalFinder:
    """A finder of bodies that are dark in most views, in an image of the searched disc."""

    fine: Projector  # projectors of all views, and of every `step`-th view
    coarse: Projector
    seen: Image  # (size, size) float32: length of the coarse rays in each pixel
    step: int

    @classmethod
    def of(cls, geometry: FanBeamGeometry, radius_mm: float) -> Self | None:
        """Search the disc of a radius around the COR; None if there are too few views, or nothing is seen."""
        frame, step = geometry.frame, max(1, geometry.angles_rad.size // MOST_VIEWS)
        # A field whose corners reach the source has no rays.
        radius = min(radius_mm, 0.7 * frame.source_distance_mm * math.cos(frame.tilt_rad))
        if radius <= 0.0 or geometry.angles_rad.size < FEWEST_VIEWS:
            return None
        size = math.ceil(2.0 * radius / max(PIXEL_MM, at_cor_mm(geometry)))
        grid = ImageGrid(min(max(size, SMALLEST_SIZE), LARGEST_SIZE), 2.0 * radius)
        coarse = Projector(geometry.with_angles(geometry.angles_rad[::step]), grid)
        seen = coarse.adjoint(np.ones(coarse.geometry.sinogram_shape, np.float32))
        return cls(Projector(geometry, grid), coarse, seen, step)

    def in_views(self, dark: Sequence[NDArray[np.bool_]], share: float) -> NDArray[np.bool_]:
        """Return the pixels (slices, size, size) that are dark in this share of the views that see them."""
        views = self.coarse.adjoint(np.stack(dark))
        return (views >= share * self.seen) & (self.seen > 0.0)

    def bodies(self, shadows: Sequence[Shadows], before: Image | None = None) -> Image:
        """Return the attenuation of metal above the wood's, (slices, size, size), 0 where there is no metal.

        It explains the shadows by expectation maximisation (Shepp and Vardi 1982, IEEE Trans. Med. Imaging 1, 113),
        where enough views are dark. Rays that cross little of that count little: they see knots at its border. The
        iterations start from what was found before, if given.
        """
        found = self.in_views([one.dark for one in shadows], SHARE_OF_VIEWS).astype(np.float32)
        busy = np.flatnonzero(found.any(axis=(1, 2))).tolist()
        if not busy:
            return found
        excess, seen = found[busy], np.stack([shadows[slice_].excess for slice_ in busy])
        lengths = self.coarse.forward(excess)
        weights = np.minimum(lengths / (2.0 * self.coarse.grid.pixel_mm), 1.0)
        of_weights = np.maximum(self.coarse.adjoint(weights), np.float32(1e-6))
        if before is not None:
            excess *= before + ALSO_SHARE * before.mean(where=before > 0.0)
            lengths = self.coarse.forward(excess)
        for _ in range(ITERATIONS if before is None else LATER_ITERATIONS):
            ratio = np.divide(weights * seen, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
            excess *= self.coarse.adjoint(ratio) / of_weights
            lengths = self.coarse.forward(excess)
        for slice_, values in zip(busy, excess, strict=True):
            found[slice_] = self._pieces(values, shadows[slice_].wood_per_mm)
        return found

    def _pieces(self, excess: Image, wood_per_mm: float) -> Image:
        """Return the excess (size, size) of pieces that are dense and large enough, 0 elsewhere."""
        pieces, count = scipy.ndimage.label(excess > TIMES_WOOD * wood_per_mm)
        peaks = np.append(np.inf, scipy.ndimage.maximum(excess, pieces, np.arange(1, count + 1)))
        dense = np.where(excess > SHARE_OF_PEAK * peaks[pieces], excess, np.float32(0.0))
        least = LEAST_PIECE_MM2 * wood_per_mm / self.coarse.grid.pixel_mm**2
        large = scipy.ndimage.sum_labels(dense, pieces, np.arange(count + 1)) >= least
        return np.where(large[pieces], dense, np.float32(0.0))

    def traced(self, shadows: Shadows, excess: Image) -> NDArray[np.bool_]:
        """Return the samples (views, cells) that see the metal."""
        near = scipy.ndimage.binary_dilation(excess > 0.0, np.ones((3, 3), bool))
        # Shadows of two pieces side by side are not narrow, and not dark.
        thick = self.fine.forward(excess) > THICK * shadows.least
        covered = (shadows.dark & (self.fine.forward(near) > 0.0)) | thick
        trace: NDArray[np.bool_] = scipy.ndimage.binary_dilation(covered, ALONG_DETECTOR)
        return trace


def at_cor_mm(geometry: FanBeamGeometry) -> float:
    """Return the width of a cell at the centre of rotation."""
    return geometry.scanner.detector_pitch_mm / geometry.frame.magnification


def smoothed(lines: Image) -> Image:
    """Average each cell and its neighbours (views, cells); `scipy.ndimage` for this would delay each start."""
    wide = np.pad(lines, ((0, 0), (1, 1)), mode="edge")
    smooth: Image = (wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]) / np.float32(3.0)
    return smooth
