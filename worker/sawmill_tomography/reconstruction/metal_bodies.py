"""Metal in a slice: rods or pixels that explain what departs from the line integrals of the wood.

Pixels blur a nail by as much as it is thick, and few views leave its outline open. In a slice a straight nail is a
rectangle of even density: six numbers, which some hundred rays show to a tenth of a millimetre.
"""

import math
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FanViews, FloatArray, rotate
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Image, Projector

# The constants of this file were measured with benchmarks/log_metal.py.
# Number of rays in a cell, whose intensities are averaged.
RAYS_PER_CELL = 3
# Pieces of an image that become rods: their number, and their least mass as a share of the largest one's.
MOST_RODS, LEAST_SHARE = 4, 0.02
# Limits of a rod's thickness, of how far its middle moves from where the image has it, and of its reach as a share of
# the source's distance.
THINNEST_MM, THICKEST_MM, FARTHEST_MM, CLEAR = 0.5, 20.0, 10.0, 0.95
# Limits of the attenuation in 1/mm: lead attenuates 6 at 60 keV.
PER_MM = (1e-4, 10.0)
# The fit starts with a thickness between these, as the image is blurred.
START_MM = (1.0, 4.0)
# Hardening at the start of the fit and at most, and the deviation expected of it: a thin nail does not show it.
START_HARDENING, MOST_HARDENING, USUAL_HARDENING = 0.01, 0.3, 0.02
EVALUATIONS = 30
# The fit ends when a step changes the misfit, or the numbers, by less than this share.
SETTLED = 1e-4
NUMBERS = 6
# A piece within this distance of a rod is a part of it.
BESIDE_MM = 5.0
# A rod is drawn with this number of points across its thickness.
PARTS = 8
# Least sine of the angle between a ray and a rod's side.
PARALLEL = 1e-12

Samples = NDArray[np.floating]


class MetalBody(Protocol):
    """Metal in a slice."""

    def line_integrals(self, geometry: FanViews, seen: NDArray[np.bool_]) -> FloatArray:
        """Return what the metal adds to the line integrals of the samples (views, cells) that are True, (samples,)."""

    def on(self, grid: ImageGrid) -> Image:
        """Return the attenuation above the wood's as the mean over each pixel, (size, size)."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """Metal of any shape."""

    grid: ImageGrid
    excess: Image  # (size, size) float32: attenuation above the wood's, in 1/mm

    def line_integrals(self, geometry: FanViews, seen: NDArray[np.bool_]) -> FloatArray:
        """Return `MetalBody.line_integrals`."""
        return Projector(geometry, self.grid).forward(self.excess)[seen].astype(np.float64)

    def on(self, grid: ImageGrid) -> Image:
        """Return `MetalBody.on`."""
        x, y = (_overlaps(self.grid, grid, axis) for axis in (0, 1))
        return np.asarray(x @ self.excess @ y.T, np.float32)

    def fitted(self, geometry: FanViews, departures: Image, sigma: Samples, seen: NDArray[np.bool_]) -> "Pixels":
        """Return the pixels with the mass that explains departures (views, cells) best."""
        alone = self.line_integrals(geometry, seen)
        weighted = alone / sigma[seen] ** 2
        mass = max(float(weighted @ departures[seen]), 0.0) / max(float(weighted @ alone), 1e-30)
        return Pixels(self.grid, np.float32(mass) * self.excess)


@dataclass(frozen=True, eq=False)
class Rods:
    """Straight rods in a slice."""

    rows: FloatArray  # (rods, 6)
    hardening: float  # A line integral p through rods is measured as p / (1 + hardening p)

    @classmethod
    def of(cls, values: FloatArray) -> Self:
        """Return the rods of the fitted values: the rows and the hardening."""
        return cls(values[:-1].reshape(-1, NUMBERS), float(values[-1]))

    def line_integrals(self, geometry: FanViews, seen: NDArray[np.bool_]) -> FloatArray:
        """Return `MetalBody.line_integrals`."""
        if not self.rows.size:
            return np.zeros(np.count_nonzero(seen))
        view, cell = np.nonzero(seen)
        low, high = geometry.borders_mm[cell].T
        at = low[:, None] + (np.arange(RAYS_PER_CELL) + 0.5) / RAYS_PER_CELL * (high - low)[:, None]
        source = geometry.source_mm[view, None]
        towards = (geometry.middle_mm - geometry.source_mm)[view, None] + at[..., None] * geometry.axis[view, None]
        towards /= np.hypot(towards[..., 0], towards[..., 1])[..., None]
        of_cells = np.sum([math.exp(row[5]) * _chords_mm(row, source, towards) for row in self.rows], axis=0)
        least = of_cells.min(axis=-1)
        exact = least - np.log(np.exp(least[:, None] - of_cells).mean(axis=-1))
        return np.asarray(exact / (1.0 + self.hardening * exact))

    def on(self, grid: ImageGrid) -> Image:
        """Return `MetalBody.on`."""
        image = np.zeros((grid.size, grid.size), np.float32)
        for row in self.rows:
            parts = math.ceil(PARTS * grid.pixel_mm / math.exp(row[4]))
            x, y = (_pixels_near(row, grid, axis) for axis in (0, 1))
            x_mm, y_mm = (_parts_mm(grid, axis, pixels, parts) for axis, pixels in enumerate((x, y)))
            inside = _inside(row, x_mm[:, None], y_mm, 0.0)
            covered = inside.reshape(x.stop - x.start, parts, y.stop - y.start, parts).mean(axis=(1, 3))
            image[x, y] += np.float32(math.exp(row[5])) * covered
        return image


def fitted_rods(
    excess: Image, grid: ImageGrid, geometry: FanViews, departures: Samples, sigma: Samples, seen: NDArray[np.bool_]
) -> Rods:
    """Fit a rod to each piece of an image, the largest first.

    `excess` (size, size) float32: attenuation above the wood's, in 1/mm; 0 where there is no metal, but not everywhere.
    `departures`, `sigma` (views, cells) float: what departs from the wood's line integrals, and its standard deviation.
    `seen` (views, cells) bool: samples that see metal.
    """
    pieces, count = scipy.ndimage.label(excess > 0.0, np.ones((3, 3)))
    masses = scipy.ndimage.sum_labels(excess, pieces, np.arange(1, count + 1))
    rods, found = Rods(np.zeros((0, NUMBERS)), START_HARDENING), np.zeros((0, NUMBERS))
    for piece in np.argsort(-masses)[:MOST_RODS].tolist():
        row = _rod_of(np.where(pieces == piece + 1, excess, 0.0), grid)
        is_small = masses[piece] < LEAST_SHARE * masses.max()
        is_part = any(_inside(rod, row[0], row[1], BESIDE_MM) for rod in rods.rows)
        if not (is_small or is_part or _longest_mm(row, geometry) < math.exp(row[3])):
            found, more = np.vstack([found, row]), Rods(np.vstack([rods.rows, row]), rods.hardening)
            rods = _fitted(more, found, geometry, departures[seen], sigma[seen], seen)
    return rods


def _fitted(
    rods: Rods, found: FloatArray, geometry: FanViews, departures: Samples, sigma: Samples, seen: NDArray[np.bool_]
) -> Rods:
    """Return the rods that explain the departures (samples,) best, from these rods, near those in the image."""

    def residuals(values: FloatArray) -> FloatArray:
        missed = (departures - Rods.of(values).line_integrals(geometry, seen)) / sigma
        return np.append(missed, values[-1] / USUAL_HARDENING)

    low, high = np.full((2, *rods.rows.shape), [[[-math.inf]], [[math.inf]]])
    for row, least, most in zip(found, low, high, strict=True):
        least[:2], most[:2] = row[:2] - FARTHEST_MM, row[:2] + FARTHEST_MM
        least[3:5] = math.log(THINNEST_MM)
        most[3:5] = math.log(_longest_mm(row, geometry)), math.log(THICKEST_MM)
    low[:, 5], high[:, 5] = np.log(PER_MM)
    best = scipy.optimize.least_squares(
        residuals,
        np.append(np.clip(rods.rows, low, high), rods.hardening),
        bounds=(np.append(low, 0.0), np.append(high, MOST_HARDENING)),
        x_scale="jac",
        ftol=SETTLED,
        xtol=SETTLED,
        max_nfev=EVALUATIONS,
    )
    return Rods.of(best.x)


def _longest_mm(row: FloatArray, geometry: FanViews) -> float:
    """Return the length of a rod that stays clear of the source wherever the fit moves its middle."""
    return 2.0 * (CLEAR * geometry.clear_mm - THICKEST_MM - math.sqrt(2.0) * FARTHEST_MM - math.hypot(row[0], row[1]))


def _rod_of(excess: FloatArray, grid: ImageGrid) -> FloatArray:
    """Return the rod (6,) with the middle, the axes and the mass of an image."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm, indexing="ij")
    mass = float(excess.sum())
    middle_x, middle_y = float((excess * x).sum()) / mass, float((excess * y).sum()) / mass
    x, y = x - middle_x, y - middle_y
    across = float((excess * x * y).sum())
    moments = np.array([[float((excess * x * x).sum()), across], [across, float((excess * y * y).sum())]]) / mass
    (short, long), axes = np.linalg.eigh(moments)
    # A rod's second moment along an axis is a twelfth of its length squared.
    thickness, length = (math.sqrt(12.0 * max(float(moment), 0.0)) for moment in (short, long))
    thickness, length = float(np.clip(thickness, *START_MM)), max(length, START_MM[0])
    density = mass * grid.pixel_mm**2 / (length * thickness)
    direction = math.atan2(axes[1, 1], axes[0, 1])
    return np.array([middle_x, middle_y, direction, math.log(length), math.log(thickness), math.log(density)])


def _chords_mm(row: FloatArray, source: FloatArray, towards: FloatArray) -> FloatArray:
    """Return the lengths in a rod of rays (samples, rays) with sources and unit directions (samples, any, 2)."""
    enter, leave = np.float64(-math.inf), np.float64(math.inf)
    starts = rotate(-row[2], source[..., 0] - row[0], source[..., 1] - row[1])
    steps = rotate(-row[2], towards[..., 0], towards[..., 1])
    for start, step, half in zip(starts, steps, 0.5 * np.exp(row[3:5]), strict=True):
        # A ray along a side is moved off it.
        pace = np.where(np.abs(step) < PARALLEL, PARALLEL, step)
        first, last = (-half - start) / pace, (half - start) / pace
        enter, leave = np.maximum(enter, np.minimum(first, last)), np.minimum(leave, np.maximum(first, last))
    return np.asarray(np.maximum(leave - enter, 0.0))


def _inside(row: FloatArray, x_mm: FloatArray, y_mm: FloatArray, margin_mm: float) -> NDArray[np.bool_]:
    """Return which points are inside a rod with a margin."""
    along, aside = rotate(-row[2], x_mm - row[0], y_mm - row[1])
    length, thickness = 0.5 * np.exp(row[3:5]) + margin_mm
    return np.asarray((np.abs(along) < length) & (np.abs(aside) < thickness))


def _pixels_near(row: FloatArray, grid: ImageGrid, axis: int) -> slice:
    """Return the pixels along an axis that a rod may reach."""
    reach = 0.5 * float(np.exp(row[3:5]).sum())
    ends = (row[axis] + np.array([-reach, reach]) - grid.low_mm[axis]) / grid.pixel_mm
    first, last = np.clip([math.floor(ends[0]), math.ceil(ends[1])], 0, grid.size).tolist()
    return slice(first, last)


def _parts_mm(grid: ImageGrid, axis: int, pixels: slice, parts: int) -> FloatArray:
    """Return the middles of the parts of pixels along an axis."""
    numbers = np.arange(pixels.start * parts, pixels.stop * parts, dtype=np.float64)
    return grid.low_mm[axis] + (numbers + 0.5) * grid.pixel_mm / parts


def _overlaps(source: ImageGrid, target: ImageGrid, axis: int) -> FloatArray:
    """Return shares of the source's pixels in each of the target's along an axis, (target size, source size)."""
    source_ends, target_ends = (
        grid.low_mm[axis] + np.arange(grid.size + 1, dtype=np.float64) * grid.pixel_mm for grid in (source, target)
    )
    common = np.minimum(source_ends[1:], target_ends[1:, None]) - np.maximum(source_ends[:-1], target_ends[:-1, None])
    return np.asarray(np.maximum(common, 0.0) / target.pixel_mm)
