"""A synthetic log: heartwood, growth rings, knots and a metal fragment, as polygons and discs.

The density of the log's shapes is attenuation per mm, so that projecting the log gives dimensionless line integrals.

Rings are those of real wood, by measured moments: the median width and the contrast of the CT slice of a tree
(docs/understand/wood.md); the spread of widths, their correlation, the late wood's share and the rings' densities of
three increment cores (UGent-Woodlab, XCT.read); the pith's distance of a fir's section (M. Ishida, TreeRingShape).
Outlines are circles.
"""

import math
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class _Knot:
    direction_rad: float
    height_mm: float
    length_mm: float
    radius_mm: float
    rise: float


@dataclass(frozen=True)
class LogModel:
    """A synthetic log; `slice_at` gives its cross-section at a height. Equal seeds give equal logs."""

    radius_mm: float
    pith_mm: tuple[float, float]
    # (radius in radii of the log, relative density within it) of each border of early and late wood, from the bark
    rings: tuple[tuple[float, float], ...]
    knots: tuple[_Knot, ...]
    metal_mm: tuple[float, float]
    metal_height_mm: float
    metal_radius_mm: float = 2.5

    @classmethod
    def random(cls, seed: int, *, radius_mm: float = 130.0, length_mm: float = 400.0) -> "LogModel":
        """Make a log with a whorl of knots every 120 mm and one metal fragment halfway along."""
        rng = np.random.default_rng(seed)
        pith = rng.uniform(-PITH_REACH, PITH_REACH, 2) * radius_mm
        knots: list[_Knot] = []
        for whorl in np.arange(60.0, length_mm + 60.0, 120.0):
            first = rng.uniform(0.0, 2.0 * math.pi)
            knots += [
                _Knot(
                    direction_rad=first + branch * math.pi / 2.0 + rng.uniform(-0.3, 0.3),
                    height_mm=whorl + rng.uniform(-15.0, 15.0),
                    length_mm=rng.uniform(0.6, 1.0) * radius_mm,
                    radius_mm=rng.uniform(8.0, 16.0),
                    rise=rng.uniform(0.05, 0.25),
                )
                for branch in range(4)
            ]
        angle = rng.uniform(0.0, 2.0 * math.pi)
        depth = rng.uniform(0.3, 0.7) * radius_mm
        return cls(
            radius_mm=radius_mm,
            pith_mm=(float(pith[0]), float(pith[1])),
            rings=_random_rings(rng, radius_mm),
            knots=tuple(knots),
            metal_mm=(depth * math.cos(angle), depth * math.sin(angle)),
            metal_height_mm=0.5 * length_mm,
        )

    def slice_at(self, height_mm: float) -> Phantom:
        """Return the cross-section at a height, densities in attenuation per mm."""
        shapes: list[Shape] = [Disc((0.0, 0.0), self.radius_mm, SAPWOOD_PER_MM)]
        shapes.append(Disc(self._toward_pith(HEARTWOOD), HEARTWOOD * self.radius_mm, HEARTWOOD_PER_MM - SAPWOOD_PER_MM))
        shapes += self._ring_discs()
        cuts = (self._knot_polygon(knot, height_mm) for knot in self.knots)
        shapes += [cut for cut in cuts if cut is not None]
        if abs(height_mm - self.metal_height_mm) < 4.0 * self.metal_radius_mm:
            shapes.append(Disc(self.metal_mm, self.metal_radius_mm, METAL_PER_MM))
        return Phantom(f"log at {height_mm:g} mm", tuple(shapes))

    def _toward_pith(self, relative_radius: float) -> tuple[float, float]:
        share = 1.0 - relative_radius
        return share * self.pith_mm[0], share * self.pith_mm[1]

    def _ring_discs(self) -> list[Shape]:
        """Return the steps of density at the borders of early and late wood, as discs."""
        discs, outside = list[Shape](), 0.0
        for radius, denser in self.rings:
            density = denser * (HEARTWOOD_PER_MM if radius < HEARTWOOD else SAPWOOD_PER_MM)
            discs.append(Disc(self._toward_pith(radius), radius * self.radius_mm, density - outside))
            outside = density
        return discs

    def _knot_polygon(self, knot: _Knot, height_mm: float) -> Polygon | None:
        """Return a rising, widening branch cut by the plane of the slice; None where the plane misses the branch."""
        along = np.linspace(0.0, knot.length_mm, 48)
        width = knot.radius_mm * (0.25 + 0.75 * along / knot.length_mm)
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
