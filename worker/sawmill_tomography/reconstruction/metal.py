"""Metal in a log: nails, screws and fragments, found by shadows that wood cannot make, and removed from the sinogram.

Rays through metal are starved and hardened: filtering them draws streaks over the whole slice. They are interpolated
along the detector from neighbouring rays (linear interpolation of projections: Kalender, Hebel and Ebersberger 1987,
Radiology 164, 576), or left out by methods that do not need them. Methods that weigh each ray keep those through thin
metal, less the metal. Where the shadow is wide, an image of the other rays shows the wood, so that metal is found again
as what departs from it, and only the departures are interpolated (normalised metal artefact reduction: Meyer et al.
2010, Medical Physics 37, 5482).

Metal in a phantom or a log: bodies that shadows show, in most views, as much denser than wood. Shadows are what line
integrals have beyond the wood: of a phantom the residual of its fit, of a log what is narrower than wood can be, or
departs from an image of the other rays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanViews, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.metal_bodies import MetalBody, Pixels, fitted_rods
from sawmill_tomography.reconstruction.total_variation import total_variation
from sawmill_tomography.sinograms.noise import estimated_noise, photon_noise
from sawmill_tomography.sinograms.present_rows import bridged_samples

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
# THICK times as much is in the shadow of a body, whatever lies beside it.
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


@dataclass(frozen=True)
class MetalFinder:
    """A finder of bodies that are dark in most views, in an image of the searched disc."""

    fine: Projector  # projectors of all views, and of every `step`-th view
    coarse: Projector
    step: int

    @classmethod
    def of(cls, geometry: FanViews, radius_mm: float) -> Self | None:
        """Search the disc of a radius around the COR; None if there are too few views, or nothing is seen."""
        step = max(1, geometry.angles_rad.size // MOST_VIEWS)
        # A field whose corners reach the source has no rays.
        radius = min(radius_mm, 0.7 * geometry.clear_mm)
        if radius <= 0.0 or geometry.angles_rad.size < FEWEST_VIEWS:
            return None
        size = math.ceil(2.0 * radius / max(PIXEL_MM, geometry.cell_at_cor_mm))
        grid = ImageGrid(min(max(size, SMALLEST_SIZE), LARGEST_SIZE), 2.0 * radius)
        return cls(Projector(geometry, grid), Projector(geometry.at(slice(None, None, step)), grid), step)

    @cached_property
    def seen(self) -> Image:
        """Length of the coarse rays in each pixel, (size, size)."""
        return self.coarse.adjoint(np.ones(self.coarse.geometry.sinogram_shape, np.float32))

    def in_views(self, dark: Sequence[NDArray[np.bool_]], share: float) -> NDArray[np.bool_]:
        """Return the pixels (slices, size, size) that are dark in this share of the views that see them."""
        found = np.zeros((len(dark), self.coarse.grid.size, self.coarse.grid.size), bool)
        # A pixel of a scanner that sees half of the log is seen in half of the views.
        busy = [number for number, one in enumerate(dark) if one.any(axis=1).mean() >= 0.5 * share]
        if busy:
            of_dark = self.coarse.adjoint(np.stack([dark[number] for number in busy]))
            found[busy] = (of_dark >= share * self.seen) & (self.seen > 0.0)
        return found

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
        covered = (shadows.dark & (self.fine.forward(near) > 0.0)) | (self.fine.forward(excess) > THICK * shadows.least)
        return scipy.ndimage.binary_dilation(covered, ALONG_DETECTOR)


def smoothed(lines: Image) -> Image:
    """Average each cell and its neighbours (views, cells); `scipy.ndimage` for this would delay each start."""
    wide = np.pad(lines, ((0, 0), (1, 1)), mode="edge")
    return (wide[:, :-2] + wide[:, 1:-1] + wide[:, 2:]) / np.float32(3.0)


INTERPOLATION = (
    "linear interpolation of projections (Kalender, Hebel and Ebersberger 1987); of wide shadows, of what departs from "
    "an image of the other rays (Meyer et al. 2010)"
)
WITHOUT_RAYS = (
    "no weight, or little, for rays through metal (metal found by expectation maximisation, Shepp and Vardi 1982)"
)

# Measured with benchmarks/log_metal.py, as the constants below.
# A shadow is narrower than LONGEST_MM at the COR, and attenuates more than the shadows on either side of it.
LONGEST_MM = 80.0
# A slice is searched if something in it has a shadow narrower than NARROW_MM at the COR in this share of the views: a
# nail of 100 mm in a quarter of them.
NARROW_MM, NARROW_SHARE = 40.0, 0.2
# Metal with a misfit above GOOD_MISFIT is found again in ROUNDS[0] rounds, and in up to ROUNDS[1] until it is good. A
# round makes an image of the other rays, in which no wood attenuates more than MOST_WOOD times the mean. A slice
# costs a second of processor time.
GOOD_MISFIT, ROUNDS, MOST_WOOD = 1.0, (2, 4), 2.5
# What departs from the wood is wrong by photon noise, WOOD_ERROR_MM of wood and METAL_ERROR of the departure.
WOOD_ERROR_MM, METAL_ERROR = 5.0, 0.05
# The line integrals of metal that explains the departures to these errors are wrong by this share of them and by
# LEAST_ERROR_MM of wood; with a misfit of 2 by four times as much, as a bent nail's are. A ray with an error above
# MOST_UNCERTAIN is left out.
METAL_SHARE, LEAST_ERROR_MM, MOST_UNCERTAIN = 0.03, 2.0, 0.5
# Pixels, which may be anything, are taken if their misfit is less than this share of the rods'.
PIXELS_BETTER = 0.5
# A larger share of a slice's samples is not taken out.
MOST_SAMPLES = 0.2


@dataclass(frozen=True, eq=False)
class LogMetal:
    """The metal of one slice."""

    trace: NDArray[np.bool_]  # (views, cells) bool: samples whose rays cross metal, with a margin
    filled: Image  # (views, cells) float32: the sinogram with those samples interpolated: the log without its metal
    # (views, cells) float32: the sinogram less the line integrals of the metal in those samples, and the standard
    # deviation of that: 0 in other samples, infinite where the metal is so thick that the sample is interpolated
    freed: Image
    uncertainty: Image  # (views, cells) float32
    body: MetalBody  # the metal itself: rods, or pixels
    misfit: float  # RMS of what the metal misses in those samples, over its expected errors

    @property
    def is_too_much(self) -> bool:
        """True if metal crosses more samples than may be taken out (`MOST_SAMPLES`)."""
        return float(self.trace.mean()) > MOST_SAMPLES


class MetalSearch(MetalFinder):
    """The search for metal in slices of a log, from which it is taken out."""

    def find(self, lines: Image) -> list[LogMetal | None]:
        """Find the metal of each slice of a block (slices, views, detector); None for a slice without metal."""
        coarse = lines[:, :: self.step]
        narrow = [_narrow(self.coarse.geometry, line, NARROW_MM) for line in coarse]
        small = self.in_views([one.dark for one in narrow], SHARE_OF_VIEWS)
        long = self.in_views([one.excess > THICK * one.least for one in narrow], NARROW_SHARE)
        suspects = (small | long).any(axis=(1, 2))
        metals: list[LogMetal | None] = [None] * len(lines)
        if suspects.any():
            excess = self.bodies([_narrow(self.coarse.geometry, line) for line in coarse[suspects]])
            for slice_, one in zip(np.flatnonzero(suspects).tolist(), excess, strict=True):
                metals[slice_] = self._metal(lines[slice_], one) if one.any() else None
        return metals

    def _metal(self, sinogram: Image, excess: Image) -> LogMetal | None:
        """Return the metal of a slice with this excess, which is not 0; None if the other rays show that it is wood."""
        shadows = _narrow(self.fine.geometry, sinogram)
        trace = self.traced(shadows, excess)
        if not trace[:: self.step].any():
            return None
        filled = np.asarray(bridged_samples(sinogram, trace), np.float32)
        # Averaged cells would hide a nail.
        photons = photon_noise(sinogram, estimated_noise(sinogram) ** -2, smoothed=1)
        metal = self._taken_out(sinogram, filled, trace, excess, photons, shadows.wood_per_mm)
        if metal.misfit <= GOOD_MISFIT or metal.is_too_much:
            return metal
        lines, uncertainty = filled, np.where(trace, math.inf, 0.0)
        for number in range(1, ROUNDS[1] + 1):
            image = image_of_other_rays(self.coarse, lines[:: self.step], uncertainty[:: self.step])
            wood = self.fine.forward(np.minimum(image, np.float32(MOST_WOOD * shadows.wood_per_mm)))
            shadows = replace(shadows, excess=np.maximum(smoothed(sinogram - wood), 0.0))
            excess = self.bodies([replace(shadows, excess=shadows.excess[:: self.step])], excess)[0]
            trace = self.traced(shadows, excess)
            if not trace[:: self.step].any():
                return None
            filled = np.where(trace, wood + bridged_samples(sinogram - wood, trace), sinogram)
            metal = self._taken_out(sinogram, filled, trace, excess, photons, shadows.wood_per_mm)
            if number >= ROUNDS[0] and metal.misfit <= GOOD_MISFIT:
                break
            lines, uncertainty = metal.freed, np.hypot(metal.uncertainty, photons * trace)
        return metal

    def _taken_out(
        self,
        sinogram: Image,
        filled: Image,
        trace: NDArray[np.bool_],
        excess: Image,
        photons: FloatArray,
        wood_per_mm: float,
    ) -> LogMetal:
        """Return the metal that explains best what departs from the wood's sinogram in the samples of the trace."""
        departures = sinogram - filled
        error = np.hypot(np.hypot(photons, WOOD_ERROR_MM * wood_per_mm), METAL_ERROR * departures)
        some = slice(None, None, self.step)
        rods = fitted_rods(excess, self.fine.grid, self.coarse.geometry, departures[some], error[some], trace[some])
        pixels = Pixels(self.fine.grid, excess).fitted(self.fine.geometry, departures, error, trace)
        bodies: tuple[MetalBody, ...] = (rods, pixels)
        alone = np.array([body.line_integrals(self.fine.geometry, trace) for body in bodies])
        misfits = np.sqrt(np.mean(((departures[trace] - alone) / error[trace]) ** 2, axis=1))
        best = int(misfits[1] < PIXELS_BETTER * misfits[0])
        misfit = float(misfits[best])
        uncertain = np.hypot(METAL_SHARE * alone[best], LEAST_ERROR_MM * wood_per_mm) * max(misfit, 1.0) ** 2
        is_lost = uncertain > MOST_UNCERTAIN
        freed, uncertainty = sinogram.copy(), np.zeros_like(sinogram)
        freed[trace] = np.where(is_lost, filled[trace], sinogram[trace] - alone[best])
        uncertainty[trace] = np.where(is_lost, math.inf, uncertain)
        return LogMetal(trace, filled, freed, uncertainty, bodies[best], misfit)


def _narrow(geometry: FanViews, sinogram: Image, longest_mm: float = LONGEST_MM) -> Shadows:
    """Find the shadows by a grey opening along the detector: it removes what is narrower than its window."""
    cell_mm = geometry.cell_at_cor_mm
    smooth = smoothed(sinogram)
    wide = _opened(smooth, NARROW_MM / cell_mm)
    if longest_mm > NARROW_MM:
        # A small body is itself no wider than that: a shadow has at most half its width.
        half_mm = 0.5 * _width_mm(wide - wide.min(axis=1, keepdims=True), cell_mm)
        wide = _opened(smooth, max(min(longest_mm, half_mm), NARROW_MM) / cell_mm)
    lines = wide - wide.min(axis=1, keepdims=True)
    # The mean of a round log: over a disc's diameter D line integrals sum up to pi / 4 mu D^2.
    sums = float(np.median(lines.sum(axis=1))) * cell_mm
    wood = 4.0 / math.pi * sums / max(_width_mm(lines, cell_mm), cell_mm) ** 2
    return Shadows(smooth - wide, max(LEAST_WOOD_MM * wood, LEAST_NOISE * estimated_noise(sinogram)), wood)


def _opened(lines: Image, cells: float) -> Image:
    """Return lines (views, cells) without what is narrower than a number of cells."""
    return scipy.ndimage.grey_opening(lines, size=(1, max(round(cells), 1)))


def _width_mm(lines: Image, cell_mm: float) -> float:
    """Return the width of the log in the median view."""
    return float(np.median((lines > 0.1 * np.median(lines.max(axis=1))).sum(axis=1))) * cell_mm


# Measured with benchmarks/production_logs.py and benchmarks/log_metal.py.
# The errors of a ray by the pixels, as a share of the longest path, and the weight in 1 / the longest path's mean
# attenuation. A fixed weight costs a quarter of one that is chosen, and the errors in the other rays are the same.
PIXELS_SHARE, WEIGHT = 0.005, 10.0


def image_of_other_rays(projector: Projector, sinogram: Image, uncertainty: NDArray[np.floating]) -> Image:
    """Return the total-variation image (size, size), in 1/mm, of the rays that are known.

    `sinogram` (views, detector) float32: line integrals whose air is at 0, and estimates of some, from which the
    descent starts. `uncertainty` (views, detector) float: further standard deviation of each ray; infinite for
    estimates.
    """
    longest = float(sinogram.max())
    noise = np.hypot(longest * PIXELS_SHARE, uncertainty)
    return total_variation(projector, sinogram, noise=noise, weight=WEIGHT * projector.grid.field_mm / longest).image
