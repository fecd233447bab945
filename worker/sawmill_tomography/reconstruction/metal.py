"""Metal in a log: nails, screws and fragments, found by shadows that wood cannot make, and removed from the sinogram.

Rays through metal are starved and hardened: filtering them draws streaks over the whole slice. They are interpolated
along the detector from neighbouring rays (linear interpolation of projections: Kalender, Hebel and Ebersberger 1987,
Radiology 164, 576), or left out by methods that do not need them. Methods that weigh each ray keep those through thin
metal, less the metal. Where the shadow is wide, an image of the other rays shows the wood, so that metal is found again
as what departs from it, and only the departures are interpolated (normalised metal artefact reduction: Meyer et al.
2010, Medical Physics 37, 5482).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.other_rays import image_of_other_rays
from sawmill_tomography.sinograms.bridging import bridged_samples, runs_of
from sawmill_tomography.sinograms.noise import estimated_noise

INTERPOLATION = (
    "linear interpolation of projections (Kalender, Hebel and Ebersberger 1987); of wide shadows, of what departs from "
    "an image of the other rays (Meyer et al. 2010)"
)
WITHOUT_RAYS = (
    "no weight, or little, for rays through metal (metal found by expectation maximisation, Shepp and Vardi 1982)"
)

# The constants of this file were measured with benchmarks/log_metal.py.
# Fewer views do not show a body by its shadows. Every second of twice as many views as MOST_VIEWS makes the image, and
# so on: 10 ms of processor time for a slice with knots, 1 ms for one without narrow shadows.
FEWEST_VIEWS, MOST_VIEWS = 8, 24
# Pixels of the image: their side, and their number along each side.
PIXEL_MM, SMALLEST_SIZE, LARGEST_SIZE = 2.0, 16, 512
# A shadow is narrower than LONGEST_MM at the COR, and attenuates more than the shadows on either side of it: by
# as much as LEAST_WOOD_MM of wood, and by LEAST_NOISE standard deviations of a sample. Line integrals are averaged over
# SMOOTHED cells.
LONGEST_MM, LEAST_WOOD_MM, LEAST_NOISE, SMOOTHED = 80.0, 5.0, 3.0, 3
# A body has such a shadow in more than this share of the views. Knots and rings on its rays hide it in some of them.
SHARE_OF_VIEWS = 0.4
# A slice is searched if something in it has a shadow narrower than NARROW_MM at the COR in this share of the views: a
# nail of 100 mm in a quarter of them.
NARROW_MM, NARROW_SHARE = 40.0, 0.2
ITERATIONS = 12
# Metal with a shadow wider than NARROW_MM at the COR is found again in ROUNDS rounds. Each makes an image of the other
# rays, in which no wood attenuates more than MOST_WOOD times the mean, and does LATER_ITERATIONS. These start from the
# metal found before, and elsewhere from ALSO_SHARE of the metal's mean. A slice costs half a second of processor time.
ROUNDS, MOST_WOOD, LATER_ITERATIONS, ALSO_SHARE = 2, 2.5, 40, 0.1
# THICK times as much is in the shadow of a body, whatever lies beside it.
THICK = 4.0
# Metal attenuates TIMES_WOOD times more than the wood around it, and a piece as much as LEAST_PIECE_MM2 of wood. Wood
# alone makes pieces of 30 mm² at most; a nail of 3.2 mm across the slice, 6 times as dense as the wood, one of 55. What
# attenuates less than SHARE_OF_PEAK of a piece's largest attenuation is its blurred border.
TIMES_WOOD, LEAST_PIECE_MM2, SHARE_OF_PEAK = 3.5, 50.0, 0.3
# The line integrals of the metal alone are wrong by this share of them, since steel hardens the beam. A ray with an
# error above MOST_UNCERTAIN is left out.
UNCERTAIN, MOST_UNCERTAIN = 0.1, 0.5
# Cells next to the shadow of metal that are interpolated too.
MARGIN = 1
# A larger share of a slice's samples is not taken out.
MOST_SAMPLES = 0.2

ALONG_DETECTOR = np.ones((1, 2 * MARGIN + 1), bool)


@dataclass(frozen=True, eq=False)
class LogMetal:
    """The metal of one slice.

    Attributes
    ----------
    trace : (views, cells) bool
        Samples whose rays cross metal, with a margin.
    filled : (views, cells) float32
        The sinogram with those samples interpolated: the log without its metal.
    freed, uncertainty : (views, cells) float32
        The sinogram less the line integrals of the metal in those samples, and the standard deviation of that: 0 in
        other samples, infinite where the metal is so thick that the sample is interpolated.
    grid : ImageGrid
    excess : (size, size) float32
        Attenuation above the wood's, 0 where there is no metal.
    """

    trace: NDArray[np.bool_]
    filled: Image
    freed: Image
    uncertainty: Image
    grid: ImageGrid
    excess: Image

    @property
    def is_too_much(self) -> bool:
        """True if metal crosses more samples than may be taken out (`MOST_SAMPLES`)."""
        return float(self.trace.mean()) > MOST_SAMPLES

    def on(self, grid: ImageGrid) -> Image:
        """Return the excess as the mean over each pixel of another grid, (size, size)."""
        x, y = (_overlaps(self.grid, grid, axis) for axis in (0, 1))
        return np.asarray(x @ self.excess @ y.T, np.float32)


@dataclass(frozen=True)
class MetalSearch:
    """The search for metal: bodies that are narrow and dark in most views, in an image of the whole log.

    Attributes
    ----------
    fine, coarse : Projector
        Projectors of all views, and of every `step`-th view.
    seen : (size, size) float32
        Length of the coarse rays in each pixel.
    """

    fine: Projector
    coarse: Projector
    seen: Image
    step: int

    @classmethod
    def of(cls, geometry: FanBeamGeometry, radius_mm: float) -> "MetalSearch | None":
        """Search the disc of a radius around the COR; None if there are too few views, or nothing is seen."""
        frame, step = geometry.frame, max(1, geometry.angles_rad.size // MOST_VIEWS)
        # A field whose corners reach the source has no rays.
        radius = min(radius_mm, 0.7 * frame.source_distance_mm * math.cos(frame.tilt_rad))
        if radius <= 0.0 or geometry.angles_rad.size < FEWEST_VIEWS:
            return None
        size = math.ceil(2.0 * radius / max(PIXEL_MM, _cell_mm(geometry)))
        grid = ImageGrid(min(max(size, SMALLEST_SIZE), LARGEST_SIZE), 2.0 * radius)
        coarse = Projector(geometry.with_angles(geometry.angles_rad[::step]), grid)
        seen = coarse.adjoint(np.ones(coarse.geometry.sinogram_shape, np.float32))
        return cls(Projector(geometry, grid), coarse, seen, step)

    def find(self, lines: Image) -> list[LogMetal | None]:
        """Find the metal of each slice of a block (slices, views, detector); None for a slice without metal."""
        coarse = lines[:, :: self.step]
        narrow = [_Shadows.of(self.coarse.geometry, line, NARROW_MM) for line in coarse]
        small = self._in_views([one.dark for one in narrow], SHARE_OF_VIEWS)
        long = self._in_views([one.excess > THICK * one.least for one in narrow], NARROW_SHARE)
        suspects = (small | long).any(axis=(1, 2))
        metals: list[LogMetal | None] = [None] * len(lines)
        if suspects.any():
            excess = self._excess([_Shadows.of(self.coarse.geometry, line) for line in coarse[suspects]])
            for slice_, one in zip(np.flatnonzero(suspects).tolist(), excess, strict=True):
                metals[slice_] = self._metal(lines[slice_], one) if one.any() else None
        return metals

    def _in_views(self, dark: Sequence[NDArray[np.bool_]], share: float) -> NDArray[np.bool_]:
        """Return the pixels (slices, size, size) that are dark in this share of the views that see them."""
        views = self.coarse.adjoint(np.stack(dark))
        return (views >= share * self.seen) & (self.seen > 0.0)

    def _metal(self, sinogram: Image, excess: Image) -> LogMetal | None:
        """Return the metal of a slice with this excess, which is not 0; None if the other rays show that it is wood."""
        shadows = _Shadows.of(self.fine.geometry, sinogram)
        alone, trace = self._traced(shadows, excess)
        filled = np.asarray(bridged_samples(sinogram, trace), np.float32)
        for _ in range(ROUNDS if self._is_wide(trace) else 0):
            image = image_of_other_rays(self.coarse, filled[:: self.step], trace[:: self.step])
            wood = self.fine.forward(np.minimum(image, np.float32(MOST_WOOD * shadows.wood_per_mm)))
            shadows = shadows.by_departures(sinogram - wood)
            excess = self._excess([replace(shadows, excess=shadows.excess[:: self.step])], excess)[0]
            if not excess.any():
                return None
            alone, trace = self._traced(shadows, excess)
            filled = np.where(trace, wood + bridged_samples(sinogram - wood, trace), sinogram)
        # Thin metal has less than its mass in the pixels that are dark enough.
        mass = np.float32(max(float(np.vdot(alone, sinogram - filled)) / float(np.vdot(alone, alone)), 0.0))
        alone *= trace * mass
        error = np.where(trace, np.hypot(UNCERTAIN * alone, LEAST_WOOD_MM * shadows.wood_per_mm), 0.0)
        uncertainty = np.where(error > MOST_UNCERTAIN, math.inf, error).astype(np.float32)
        freed = np.where(np.isinf(uncertainty), filled, sinogram - alone)
        return LogMetal(trace, filled, freed, uncertainty, self.fine.grid, excess * mass)

    def _traced(self, shadows: "_Shadows", excess: Image) -> tuple[Image, NDArray[np.bool_]]:
        """Return the line integrals of the metal alone, and the samples that see it, each (views, cells)."""
        near = scipy.ndimage.binary_dilation(excess > 0.0, np.ones((3, 3), bool))
        alone = self.fine.forward(excess)
        # Shadows of two pieces side by side are not narrow, and not dark.
        covered = (shadows.dark & (self.fine.forward(near) > 0.0)) | (alone > THICK * shadows.least)
        return alone, scipy.ndimage.binary_dilation(covered, ALONG_DETECTOR)

    def _is_wide(self, trace: NDArray[np.bool_]) -> bool:
        """Return whether a shadow is wide, but not too much for the slice to be treated."""
        widest = max((length for _, _, length in runs_of(trace)), default=0)
        return widest * _cell_mm(self.fine.geometry) > NARROW_MM and float(trace.mean()) <= MOST_SAMPLES

    def _excess(self, shadows: Sequence["_Shadows"], before: Image | None = None) -> Image:
        """Return the attenuation of metal above the wood's, (slices, size, size), 0 where there is no metal.

        It explains the shadows by expectation maximisation (Shepp and Vardi 1982, IEEE Trans. Med. Imaging 1, 113),
        where enough views are dark. Rays that cross little of that count little: they see knots at its border. The
        iterations start from what was found before, if given.
        """
        found = self._in_views([one.dark for one in shadows], SHARE_OF_VIEWS).astype(np.float32)
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


@dataclass(frozen=True, eq=False)
class _Shadows:
    """The shadows of metal in a sinogram.

    Attributes
    ----------
    excess : (views, cells) float32
        What the metal adds to the line integrals of the wood, as far as known; 0 elsewhere.
    least : float
        The excess of thin wood, or of noise.
    wood_per_mm : float
        Mean attenuation of the wood.
    """

    excess: Image
    least: float
    wood_per_mm: float

    @property
    def dark(self) -> NDArray[np.bool_]:
        """True where the excess is more than `least`, (views, cells)."""
        return self.excess > self.least

    def by_departures(self, departures: Image) -> "_Shadows":
        """Return the shadows, of any width, with the departures (views, cells) from the line integrals of the wood."""
        smooth = scipy.ndimage.uniform_filter1d(departures, SMOOTHED, axis=1)
        return replace(self, excess=np.maximum(smooth, 0.0))

    @classmethod
    def of(cls, geometry: FanBeamGeometry, sinogram: Image, longest_mm: float = LONGEST_MM) -> "_Shadows":
        """Find the shadows by a grey opening along the detector: it removes what is narrower than its window."""
        cell_mm = _cell_mm(geometry)
        smooth = scipy.ndimage.uniform_filter1d(sinogram, SMOOTHED, axis=1)
        wide = _opened(smooth, NARROW_MM / cell_mm)
        if longest_mm > NARROW_MM:
            # A small body is itself no wider than that: a shadow has at most half its width.
            half_mm = 0.5 * _width_mm(wide - wide.min(axis=1, keepdims=True), cell_mm)
            wide = _opened(smooth, max(min(longest_mm, half_mm), NARROW_MM) / cell_mm)
        wood = _wood_per_mm(wide - wide.min(axis=1, keepdims=True), cell_mm)
        excess = smooth - wide
        least = max(LEAST_WOOD_MM * wood, LEAST_NOISE * estimated_noise(sinogram))
        return cls(excess, least, wood)


def _cell_mm(geometry: FanBeamGeometry) -> float:
    return geometry.scanner.detector_pitch_mm / geometry.frame.magnification


def _opened(lines: Image, cells: float) -> Image:
    """Return lines (views, cells) without what is narrower than a number of cells."""
    opened: Image = scipy.ndimage.grey_opening(lines, size=(1, max(round(cells), 1)))
    return opened


def _width_mm(lines: Image, cell_mm: float) -> float:
    """Return the width of the log in the median view."""
    widths = (lines > 0.1 * np.median(lines.max(axis=1))).sum(axis=1)
    return float(np.median(widths)) * cell_mm


def _wood_per_mm(lines: Image, cell_mm: float) -> float:
    """Return the mean attenuation of a round log: over a disc's diameter D line integrals sum up to pi / 4 mu D^2."""
    width_mm = max(_width_mm(lines, cell_mm), cell_mm)
    return 4.0 / math.pi * float(np.median(lines.sum(axis=1))) * cell_mm / width_mm**2


def _overlaps(source: ImageGrid, target: ImageGrid, axis: int) -> FloatArray:
    """Return shares of the source's pixels in each of the target's along an axis, (target size, source size)."""
    source_ends, target_ends = (
        grid.low_mm[axis] + np.arange(grid.size + 1, dtype=np.float64) * grid.pixel_mm for grid in (source, target)
    )
    common = np.minimum(source_ends[1:], target_ends[1:, None]) - np.maximum(source_ends[:-1], target_ends[:-1, None])
    shares: FloatArray = np.maximum(common, 0.0) / target.pixel_mm
    return shares
