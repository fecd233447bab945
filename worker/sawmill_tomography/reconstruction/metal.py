"""Metal in a log: nails, screws and fragments, found by shadows that wood cannot make, and removed from the sinogram.

Rays through metal are starved and hardened: filtering them draws streaks over the whole slice. They are interpolated
along the detector from neighbouring rays (linear interpolation of projections: Kalender, Hebel and Ebersberger 1987,
Radiology 164, 576), or left out by methods that do not need them. Methods that weigh each ray keep those through thin
metal, less the metal. Where the shadow is wide, an image of the other rays shows the wood, so that metal is found again
as what departs from it, and only the departures are interpolated (normalised metal artefact reduction: Meyer et al.
2010, Medical Physics 37, 5482).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.reconstruction.metal_bodies import MetalBody, Pixels, fitted_rods
from sawmill_tomography.reconstruction.metal_finder import (
    LEAST_NOISE,
    LEAST_WOOD_MM,
    SHARE_OF_VIEWS,
    THICK,
    MetalFinder,
    Shadows,
    at_cor_mm,
    smoothed,
)
from sawmill_tomography.reconstruction.other_rays import image_of_other_rays
from sawmill_tomography.sinograms.bridging import bridged_samples
from sawmill_tomography.sinograms.noise import estimated_noise, photon_noise

INTERPOLATION = (
    "linear interpolation of projections (Kalender, Hebel and Ebersberger 1987); of wide shadows, of what departs from "
    "an image of the other rays (Meyer et al. 2010)"
)
WITHOUT_RAYS = (
    "no weight, or little, for rays through metal (metal found by expectation maximisation, Shepp and Vardi 1982)"
)

# The constants of this file were measured with benchmarks/log_metal.py.
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
            shadows = shadows.by_departures(sinogram - wood)
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


def _narrow(geometry: FanBeamGeometry, sinogram: Image, longest_mm: float = LONGEST_MM) -> Shadows:
    """Find the shadows by a grey opening along the detector: it removes what is narrower than its window."""
    cell_mm = at_cor_mm(geometry)
    smooth = smoothed(sinogram)
    wide = _opened(smooth, NARROW_MM / cell_mm)
    if longest_mm > NARROW_MM:
        # A small body is itself no wider than that: a shadow has at most half its width.
        half_mm = 0.5 * _width_mm(wide - wide.min(axis=1, keepdims=True), cell_mm)
        wide = _opened(smooth, max(min(longest_mm, half_mm), NARROW_MM) / cell_mm)
    wood = _wood_per_mm(wide - wide.min(axis=1, keepdims=True), cell_mm)
    excess = smooth - wide
    least = max(LEAST_WOOD_MM * wood, LEAST_NOISE * estimated_noise(sinogram))
    return Shadows(excess, least, wood)


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
