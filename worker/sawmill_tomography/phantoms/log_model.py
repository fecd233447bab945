"""A synthetic log: heartwood, growth rings, knots and a metal fragment, as polygons and a disc.

The density of the log's shapes is attenuation per mm, so that projecting the log gives dimensionless line integrals.

Rings are as in real wood, by measured moments: the median width and the contrast of the CT slice of a tree
(docs/understand/wood.md); the spread of widths, their correlation, the late wood's share and the rings' densities of
three increment cores (UGent-Woodlab, XCT.read); the pith's distance of a fir's section (M. Ishida, TreeRingShape); the
outlines of the section's 38 rings and of the slice. The fir's radius about a ring's centre varies by 3.1 % RMS: 23 % of
the variance are an ellipse, 60 % a wave of three periods, 3 % of four, 9 % of five, 5 % more. The slice's outline
varies by 2.7 %, half of it by a wave of four periods. So an outline is a polygon, and no ellipse.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sawmill_tomography.geometry.geometry import TAU
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon, Shape

# Green softwood at the 100 to 150 kV of sawmill scanners: about 0.2 per cm times a density near 0.9.
SAPWOOD_PER_MM = 0.018
HEARTWOOD_PER_MM = 0.012
# Heartwood's share of the radius.
HEARTWOOD = 0.62
KNOT_PER_MM = 0.022
METAL_PER_MM = 0.30
FIRST_LOG_SLICE_MM = 20.0
SHORTEST_LOG_MM = 400.0
# Median width, standard deviation of its logarithm, correlation of a ring's logarithm with the next one's, and the
# radius in mm within which there is no further ring.
RING_MM, RING_SPREAD, RING_CORRELATION, INNERMOST_MM = 3.3, 0.5, 0.7, 2.5
# The late wood's share of a ring; its density above the ring's mean, the early wood's below it, and the rings' standard
# deviation, relative.
LATE_SHARE, LATE_DENSER, EARLY_LIGHTER, DENSITY_SPREAD = 0.42, 0.16, 0.12, 0.07
# The pith's distance from the outline's centre along x and y, at most, in radii.
PITH_REACH = 0.1
# Waves around an outline, and the standard deviation of each one's cosine and sine, relative to the radius.
WAVES, WAVE_SPREADS = np.arange(2, 7), np.array((0.0145, 0.017, 0.014, 0.0078, 0.0078))
# Waves are drawn at these radii, in radii of the log, with this correlation from each to the next, and interpolated.
WAVE_RADII, WAVE_CORRELATION = np.linspace(0.0, 1.0, 5), 0.74
# Corners of an outline: within 0.3 mm of its curve, and no slower to project than discs.
CORNERS = 48
# Nails across the log: number, lengths, and how far from the outline's centre the head is, in radii of the log.
NAILS, NAIL_LENGTHS_MM, NAIL_HEAD = 4, (40.0, 70.0), 0.92


@dataclass(frozen=True)
class _Knot:
    direction_rad: float
    height_mm: float
    # Share of the length from the pith to the bark.
    length: float
    radius_mm: float
    rise: float


@dataclass(frozen=True)
class Nail:
    """A rod of steel across the log: middle (x, y, height), half of the length along x and y, and radius."""

    place_mm: tuple[float, float, float]
    half_mm: tuple[float, float]
    radius_mm: float = 1.75

    def cut(self, height_mm: float) -> list[Shape]:
        """Return the part that lies in the plane of a slice."""
        (x, y, middle), (a, b) = self.place_mm, self.half_mm
        if abs(height_mm - middle) >= self.radius_mm:
            return []
        wide = math.sqrt(self.radius_mm**2 - (height_mm - middle) ** 2) / math.hypot(a, b)
        ends = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
        return [Polygon(tuple((x + s * a + t * wide * b, y + s * b - t * wide * a) for s, t in ends), METAL_PER_MM)]


@dataclass(frozen=True)
class LogModel:
    """A synthetic log; `slice_at` gives its cross-section at a height. Equal seeds give equal logs."""

    radius_mm: float
    pith_mm: tuple[float, float]
    # (radius in radii of the log, relative density within it) of each border of early and late wood, from the bark
    rings: tuple[tuple[float, float], ...]
    # (cosine - i sine) of each of WAVES, at each of WAVE_RADII
    waves: tuple[tuple[complex, ...], ...]
    knots: tuple[_Knot, ...]
    metal_mm: tuple[float, float]
    metal_height_mm: float
    metal_radius_mm: float = 2.5
    nails: tuple[Nail, ...] = ()

    @classmethod
    def random(cls, seed: int, *, radius_mm: float = 130.0, length_mm: float = 400.0) -> "LogModel":
        """Make a log with a whorl of knots every 120 mm and one metal fragment halfway along."""
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-PITH_REACH, PITH_REACH, 2) * radius_mm
        knots: list[_Knot] = []
        for whorl in np.arange(60.0, length_mm + 60.0, 120.0):
            first = rng.uniform(0.0, 2.0 * math.pi)
            knots += [
                _Knot(
                    direction_rad=first + branch * math.pi / 2.0 + rng.uniform(-0.3, 0.3),
                    height_mm=whorl + rng.uniform(-15.0, 15.0),
                    length=rng.uniform(0.6, 1.0),
                    radius_mm=rng.uniform(8.0, 16.0),
                    rise=rng.uniform(0.05, 0.25),
                )
                for branch in range(4)
            ]
        angle = rng.uniform(0.0, 2.0 * math.pi)
        depth = rng.uniform(0.3, 0.7) * radius_mm
        metal = depth * math.cos(angle), depth * math.sin(angle)
        rings, waves = _random_rings(rng, radius_mm), _random_waves(rng)
        return cls(radius_mm, (float(x), float(y)), rings, waves, tuple(knots), metal, 0.5 * length_mm)

    @classmethod
    def with_nails(cls, seed: int, *, length_mm: float) -> "LogModel":
        """Make a log with nails that point about to its centre, within this length; heights count from the metal's."""
        log, rng = cls.random(seed, length_mm=max(SHORTEST_LOG_MM, length_mm)), np.random.default_rng((seed, 1))
        nails = list[Nail]()
        for height in rng.uniform(-0.4, 0.4, NAILS) * length_mm:
            at, half = rng.uniform(0.0, TAU), 0.5 * rng.uniform(*NAIL_LENGTHS_MM)
            lean, head = at + rng.uniform(-0.35, 0.35), NAIL_HEAD * log.radius_mm
            a, b = half * math.cos(lean), half * math.sin(lean)
            nails.append(Nail((head * math.cos(at) - a, head * math.sin(at) - b, float(height)), (a, b)))
        knots = tuple(replace(knot, height_mm=knot.height_mm - log.metal_height_mm) for knot in log.knots)
        return replace(log, knots=knots, metal_height_mm=0.0, nails=tuple(nails))

    @property
    def metal_places_mm(self) -> list[tuple[float, float, float]]:
        """Middles (x, y, height) of the metal and the nails."""
        return [(*self.metal_mm, self.metal_height_mm), *(nail.place_mm for nail in self.nails)]

    def slice_at(self, height_mm: float) -> Phantom:
        """Return the cross-section at a height, densities in attenuation per mm."""
        shapes: list[Shape] = [*self._clear_wood]
        shapes += [cut for knot in self.knots if (cut := self._knot_polygon(knot, height_mm)) is not None]
        if abs(height_mm - self.metal_height_mm) < 4.0 * self.metal_radius_mm:
            shapes.append(Disc(self.metal_mm, self.metal_radius_mm, METAL_PER_MM))
        shapes += [shape for nail in self.nails for shape in nail.cut(height_mm)]
        return Phantom(f"log at {height_mm:g} mm", tuple(shapes))

    def outline(self, relative_radius: float) -> tuple[tuple[float, float], ...]:
        """Return the corners (x, y) in mm of the ring of this radius, in radii of the log; 1 is the bark."""
        waves = [np.interp(relative_radius, WAVE_RADII, values) for values in zip(*self.waves, strict=True)]
        angles = TAU * np.arange(CORNERS) / CORNERS
        wave = (waves * np.exp(1j * WAVES * angles[:, None])).sum(axis=1).real
        radius = relative_radius * self.radius_mm * (1.0 + wave)
        centre_x, centre_y = ((1.0 - relative_radius) * at for at in self.pith_mm)
        x, y = centre_x + radius * np.cos(angles), centre_y + radius * np.sin(angles)
        return tuple(zip(x.tolist(), y.tolist(), strict=True))

    @cached_property
    def _clear_wood(self) -> tuple[Polygon, ...]:
        """Wood without knots: the steps of density at the bark, the heartwood, and early and late wood."""
        shapes = [
            Polygon(self.outline(1.0), SAPWOOD_PER_MM),
            Polygon(self.outline(HEARTWOOD), HEARTWOOD_PER_MM - SAPWOOD_PER_MM),
        ]
        outside = 0.0
        for radius, denser in self.rings:
            density = denser * (HEARTWOOD_PER_MM if radius < HEARTWOOD else SAPWOOD_PER_MM)
            shapes.append(Polygon(self.outline(radius), density - outside))
            outside = density
        return tuple(shapes)

    def _bark_distance_mm(self, knot: _Knot) -> float:
        """Return the length from the pith at which the knot's end meets the bark."""
        x, y = (np.array(self.outline(1.0)) - self.pith_mm).T
        turns = np.linspace(-1.0, 1.0, 5) * knot.radius_mm / self.radius_mm
        distances = np.interp(knot.direction_rad + turns, np.arctan2(y, x), np.hypot(x, y), period=TAU)
        return float((distances * np.cos(turns)).min())

    def _knot_polygon(self, knot: _Knot, height_mm: float) -> Polygon | None:
        """Return a rising, widening branch cut by the plane of the slice; None where the plane misses the branch."""
        length_mm = knot.length * self._bark_distance_mm(knot)
        along = np.linspace(0.0, length_mm, 48)
        width = knot.radius_mm * (0.25 + 0.75 * along / length_mm)
        above = height_mm - knot.height_mm - knot.rise * along
        cut = np.abs(above) < width
        if cut.sum() < 3:
            return None
        along, half = along[cut], np.sqrt(width[cut] ** 2 - above[cut] ** 2)
        c, s = math.cos(knot.direction_rad), math.sin(knot.direction_rad)
        left = [
            (self.pith_mm[0] + c * a - s * h, self.pith_mm[1] + s * a + c * h) for a, h in zip(along, half, strict=True)
        ]
        right = [
            (self.pith_mm[0] + c * a + s * h, self.pith_mm[1] + s * a - c * h) for a, h in zip(along, half, strict=True)
        ]
        corners = tuple((float(x), float(y)) for x, y in [*left, *reversed(right)])
        return Polygon(corners, KNOT_PER_MM - HEARTWOOD_PER_MM)


def log_slices(rows: int, *, row_pitch_mm: float, seed: int) -> list[Phantom]:
    """Return cross-sections of a synthetic log, a row's pitch apart."""
    heights = [FIRST_LOG_SLICE_MM + row * row_pitch_mm for row in range(rows)]
    log = LogModel.random(seed, length_mm=max(SHORTEST_LOG_MM, heights[-1]))
    return [log.slice_at(height) for height in heights]


def _random_rings(rng: np.random.Generator, radius_mm: float) -> tuple[tuple[float, float], ...]:
    """Draw rings from the bark to the pith: widths are log-normal and follow one another."""
    rings, outer, deviation = list[tuple[float, float]](), radius_mm, rng.standard_normal()
    while (width := RING_MM * math.exp(RING_SPREAD * deviation)) < outer - INNERMOST_MM:
        mean = DENSITY_SPREAD * rng.standard_normal()
        late = outer - LATE_SHARE * width
        rings += [(outer / radius_mm, mean + LATE_DENSER), (late / radius_mm, mean - EARLY_LIGHTER)]
        outer -= width
        deviation = RING_CORRELATION * deviation + math.sqrt(1.0 - RING_CORRELATION**2) * rng.standard_normal()
    return tuple(rings)


def _random_waves(rng: np.random.Generator) -> tuple[tuple[complex, ...], ...]:
    """Draw the waves of the outlines from the pith to the bark."""
    waves = list[tuple[complex, ...]]()
    values = rng.standard_normal(WAVES.size) + 1j * rng.standard_normal(WAVES.size)
    for _ in WAVE_RADII:
        waves.append(tuple((WAVE_SPREADS * values).tolist()))
        change = rng.standard_normal(WAVES.size) + 1j * rng.standard_normal(WAVES.size)
        values = WAVE_CORRELATION * values + math.sqrt(1.0 - WAVE_CORRELATION**2) * change
    return tuple(waves)
