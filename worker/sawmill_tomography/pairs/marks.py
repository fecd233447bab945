"""Nails, stones and dense knots of a log in three dimensions, from the pictures of fixed pairs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.pairs.log_pictures import LogPictures
from sawmill_tomography.statistics import exceeded_chi_square, noise_of_differences

# What these constants give is measured by benchmarks/pair_logs.py.
# Half a window of the median that shows the log without narrow marks, mm; a mark exceeds it by this line integral, and
# by this number of standard deviations of the noise.
SMOOTH_MM, LEAST, SIGNIFICANT = 12.0, 0.15, 6.0
# A mark is narrower than this along the feed or across it, and its middle is known to this, mm.
NARROW_MM, MIDDLE_MM = 24.0, 0.25
# Chance to miss a body that its pairs show, and the distance within which places of the same marks are one body's, mm.
MISSED, ONE_BODY_MM = 1e-3, 6.0
# Heights of one body's marks differ by less than this number of rows.
NEAR_ROWS = 2.5
# Of three or more pairs, this number must show a body: rays of two always meet, even of different bodies.
LEAST_PAIRS = 3


class Mark(NamedTuple):
    """A narrow dense mark in a pair's picture, mm: middle and half width on the pair's line, and height."""

    u_mm: float
    half_mm: float
    height_mm: float


@dataclass(frozen=True, eq=False)
class Body:
    """A place where rays to marks of several pairs meet, mm."""

    place_mm: FloatArray  # (3,): x, y and height
    deviations_mm: FloatArray  # (3,)
    marks: Mapping[int, int]  # number of the mark of each pair that shows it
    normals: FloatArray  # (of these pairs, 2): of the rays, and their distances from the centre
    distances_mm: FloatArray
    chi_square: float
    is_ambiguous: bool = False

    @property
    def residual_mm(self) -> float:
        """RMS distance of the place from the rays."""
        return float(np.sqrt(np.mean((self.distances_mm - self.normals @ self.place_mm[:2]) ** 2)))

    def shares(self, other: "Body") -> bool:
        """Return whether a mark of this body is one of another."""
        return bool(self.marks.items() & other.marks.items())


def marks_of(picture: FloatArray, cells_mm: FloatArray, heights_mm: FloatArray) -> list[Mark]:
    """Find narrow dense marks in a picture (rows, cells) whose cells and rows are equally spaced."""
    pitch, cell = float(heights_mm[1] - heights_mm[0]), float(cells_mm[1] - cells_mm[0])
    window = [2 * int(SMOOTH_MM / step) + 1 for step in (pitch, cell)]
    excess = picture - scipy.ndimage.median_filter(picture, size=window, mode="nearest")
    excess -= np.median(excess, axis=0)
    noise = np.array([noise_of_differences(column, 1) for column in np.diff(excess, axis=0).T])
    noise = scipy.ndimage.uniform_filter1d(noise, window[1])
    labels, _ = scipy.ndimage.label(excess > np.maximum(LEAST, SIGNIFICANT * noise))
    found = []
    for number, (down, along) in enumerate(scipy.ndimage.find_objects(labels), 1):
        own = np.where(labels[down, along] == number, excess[down, along], 0.0)
        pieces, count = scipy.ndimage.label(own > 0.5 * np.quantile(own[own > 0.0], 0.9))
        for piece in range(1, count + 1):
            rows, cells = np.nonzero(pieces == piece)
            wide = cell * (np.ptp(cells) + 1)
            if rows.size > 2 and min(pitch * (np.ptp(rows) + 1), wide) < NARROW_MM:
                middle = cells_mm[along.start] + 0.5 * cell * (cells.min() + cells.max())
                height = heights_mm[down.start] + pitch * np.average(rows, weights=own[rows, cells])
                found.append(Mark(float(middle), 0.5 * wide, float(height)))
    return found


@dataclass(frozen=True, eq=False)
class Sights:
    """Marks of all pairs in one log, and how well the geometry is known.

    `ray_errors_mm` (pairs,): predicted errors of the rays, RMS. `scale`: standard deviation of the scale, a share.
    """

    pictures: LogPictures
    marks: Sequence[Sequence[Mark]]
    ray_errors_mm: FloatArray
    scale: float

    @classmethod
    def of(cls, pictures: LogPictures, ray_errors_mm: FloatArray, scale: float) -> "Sights":
        """Find the marks in all pictures."""
        marks = [marks_of(lines, pictures.cells_mm, pictures.heights_mm) for lines in pictures.lines]
        return cls(pictures, marks, ray_errors_mm, scale)

    @property
    def middle_mm(self) -> float:
        """Standard deviation of a mark's middle, whose ends are cells."""
        return max(MIDDLE_MM, float(np.ptp(self.pictures.cells_mm[:2]) / np.sqrt(12.0)))

    def bodies(self, moved_mm: float = 0.0) -> list[Body]:
        """Return the bodies that enough pairs show, by height; sets of marks that fit crosswise are ambiguous.

        `moved_mm`: standard deviation of what rays may be off beyond their predicted errors.
        """
        found = list[Body]()
        candidates = sorted(self._candidates(moved_mm), key=lambda body: body.chi_square)
        for count in range(len(self.marks), min(len(self.marks), LEAST_PAIRS) - 1, -1):
            kept = list[Body]()
            for body in (one for one in candidates if len(one.marks) == count):
                off = [float(np.hypot(*(one.place_mm - body.place_mm)[:2])) for one in kept if one.shares(body)]
                if min(off, default=np.inf) > ONE_BODY_MM and not any(one.shares(body) for one in found):
                    kept.append(body)
            crossed = [any(one is not body and one.shares(body) for one in kept) for body in kept]
            found += [replace(body, is_ambiguous=both) for body, both in zip(kept, crossed, strict=True)]
        return sorted(found, key=lambda body: float(body.place_mm[2]))

    def _candidates(self, moved_mm: float) -> Iterator[Body]:
        """Place each two marks of different pairs, with the marks of other pairs that fit best."""
        heights = [np.array([mark.height_mm for mark in own]) for own in self.marks]
        near_mm = NEAR_ROWS * np.ptp(self.pictures.heights_mm[:2])
        for first, second in combinations(range(len(self.marks)), 2):
            for one, other in np.argwhere(np.abs(heights[first][:, None] - heights[second]) < near_mm).tolist():
                if (body := self._placed({first: one, second: other}, moved_mm)) is None:
                    continue
                for pair in set(range(len(self.marks))) - {first, second}:
                    near = np.flatnonzero(np.abs(heights[pair] - body.place_mm[2]) < near_mm).tolist()
                    more = [self._placed({**body.marks, pair: at}, moved_mm) for at in near]
                    body = min((one for one in more if one is not None), key=lambda one: one.chi_square, default=body)
                yield body

    def _placed(self, chosen: Mapping[int, int], moved_mm: float) -> Body | None:
        """Triangulate a mark of each chosen pair by weighted least squares; None where they do not fit."""
        pairs = [*chosen]
        u, halves, heights = np.array([self.marks[pair][number] for pair, number in chosen.items()]).T
        off = np.ptp(self.pictures.heights_mm[:2]) / np.sqrt(12.0)
        chi_square = float(((heights - heights.mean()) ** 2).sum()) / off**2
        allowed = exceeded_chi_square(MISSED, 2 * len(pairs) - 3)
        if chi_square > allowed:
            return None
        sources = self.pictures.views.source_mm[pairs]
        rays = u[:, None] * self.pictures.views.axis[pairs] - sources
        normals = np.stack([rays[:, 1], -rays[:, 0]], -1) / np.hypot(*rays.T)[:, None]
        distances = np.einsum("pc,pc->p", normals, sources)
        depths = np.hypot(*(np.linalg.lstsq(normals, distances)[0] - sources).T)
        bent = halves**2 / (2.0 * depths)
        if len(pairs) > 2:
            distances += bend(normals, halves**2) / depths
            bent = np.zeros_like(bent)
        known = np.hypot(np.hypot(self.middle_mm, bent), self.ray_errors_mm[pairs])
        weighted = normals / known[:, None]
        place = np.linalg.lstsq(weighted, distances / known)[0]
        chi_square += float((((distances - normals @ place) / np.hypot(known, moved_mm)) ** 2).sum())
        if chi_square > allowed:
            return None
        spread = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)) + (self.scale * place) ** 2)
        placed = np.append(place, heights.mean()), np.append(spread, off / np.sqrt(len(pairs)))
        return Body(*placed, chosen, normals, distances, chi_square)


def bend(normals: FloatArray, squares_mm2: FloatArray) -> FloatArray:
    """Return the product of the places across and along each ray, (rays,), in the mean over a body.

    Its squares across the rays (rays,) are n' V n with the normals n (rays, 2), and the product is n' V a with a along
    the ray, a quarter turn counter-clockwise of n. The middle of a rod's shadow is off the ray through its middle by
    -n' V a / depth, V = v v' of half the rod.
    """
    x, y = normals.T
    xx, xy, yy = np.linalg.lstsq(np.stack([x * x, 2.0 * x * y, y * y], -1), squares_mm2)[0]
    return np.asarray(x * y * (yy - xx) + xy * (x * x - y * y))
