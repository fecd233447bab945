"""A synthetic log: heartwood, growth rings, knots and a metal fragment, as polygons and discs.

The density of the log's shapes is attenuation per mm, so that projecting the log gives dimensionless line integrals.
"""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon, Shape

# Green softwood at the 100 to 150 kV of sawmill scanners: about 0.2 per cm times a density near 0.9.
SAPWOOD_PER_MM = 0.018
HEARTWOOD_PER_MM = 0.012
RING_CONTRAST = 0.12
KNOT_PER_MM = 0.022
METAL_PER_MM = 0.30
FIRST_LOG_SLICE_MM = 20.0
SHORTEST_LOG_MM = 400.0


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
    rings: int
    knots: tuple[_Knot, ...]
    metal_mm: tuple[float, float]
    metal_height_mm: float
    metal_radius_mm: float = 2.5

    @classmethod
    def random(cls, seed: int, *, radius_mm: float = 130.0, length_mm: float = 400.0) -> "LogModel":
        """Make a log with a whorl of knots every 120 mm and one metal fragment halfway along."""
        rng = np.random.default_rng(seed)
        pith = rng.uniform(-0.06, 0.06, 2) * radius_mm
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
            rings=int(rng.integers(9, 14)),
            knots=tuple(knots),
            metal_mm=(depth * math.cos(angle), depth * math.sin(angle)),
            metal_height_mm=0.5 * length_mm,
        )

    def slice_at(self, height_mm: float) -> Phantom:
        """Return the cross-section at a height, densities in attenuation per mm."""
        shapes: list[Shape] = [Disc((0.0, 0.0), self.radius_mm, SAPWOOD_PER_MM)]
        shapes.append(Disc(self._toward_pith(0.62), 0.62 * self.radius_mm, HEARTWOOD_PER_MM - SAPWOOD_PER_MM))
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
        """Return each ring as a bright edge: a disc and, just inside it, a disc of the opposite density."""
        discs: list[Shape] = []
        for ring in range(1, self.rings + 1):
            outer = ring / (self.rings + 1.0)
            inner = outer - 0.25 / (self.rings + 1.0)
            density = RING_CONTRAST * (HEARTWOOD_PER_MM if outer < 0.62 else SAPWOOD_PER_MM)
            discs.append(Disc(self._toward_pith(outer), outer * self.radius_mm, density))
            discs.append(Disc(self._toward_pith(inner), inner * self.radius_mm, -density))
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
