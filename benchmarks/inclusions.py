"""Inclusions between the rows of a whole log (`whole_logs.py`): wet zones, cracks, a nail, a small knot."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from choosing import ellipse

from sawmill_tomography.geometry.geometry import TAU
from sawmill_tomography.phantoms.log_model import KNOT_PER_MM, SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Polygon, Shape

NAIL_MM, NAIL_PER_MM = 8.0, 0.08
SMALL_KNOT_MM = 12.0
# Densities of a crack, and of what the water adds to a wet zone, 1/mm.
CRACK_PER_MM, WET_PER_MM = -0.0105, 0.004


@dataclass(frozen=True)
class Inclusion:
    """A body of finite length along the axis whose cross-section is a wavy ellipse that turns with the grain.

    Attributes
    ----------
    at_mm : (x, y)
        Middle of the inclusion, from the log's centre.
    half_mm : (x, y, z)
        Half-lengths along the inclusion's two axes in the plane, and along the log's axis.
    rounded : bool, bool
        True if the first, or second, half-length shrinks towards the ends along the axis like an ellipsoid's.
    """

    name: str
    height_mm: float
    at_mm: tuple[float, float]
    half_mm: tuple[float, float, float]
    rounded: tuple[bool, bool]
    turn_rad: float
    density: float
    grain_rad_per_mm: float = 0.0
    waves: float = 0.0

    def cut(self, height_mm: float) -> Shape | None:
        """Return the cross-section at a height; None beyond the ends."""
        above = height_mm - self.height_mm
        share = 1.0 - (above / self.half_mm[2]) ** 2
        if share <= 0.0:
            return None
        long, short = (
            half * (math.sqrt(share) if round_ else 1.0)
            for half, round_ in zip(self.half_mm[:2], self.rounded, strict=True)
        )
        turned = self.turn_rad + self.grain_rad_per_mm * above
        if not self.waves:
            return ellipse(*self.at_mm, long, short, turned, self.density)
        wavy = []
        for x, y in ellipse(0.0, 0.0, long, short, turned, self.density).vertices_mm:
            around = math.atan2(y, x)
            factor = 1.0 + self.waves * (math.cos(3.0 * around + self.turn_rad) + 0.6 * math.cos(5.0 * around))
            wavy.append((self.at_mm[0] + factor * x, self.at_mm[1] + factor * y))
        return Polygon(tuple(wavy), self.density)


def _place(rng: np.random.Generator, low_mm: float, high_mm: float) -> tuple[float, tuple[float, float]]:
    """Draw a direction, and a point at a random distance in this direction."""
    turn, out = rng.uniform(0.0, TAU), rng.uniform(low_mm, high_mm)
    return float(turn), (float(out * math.cos(turn)), float(out * math.sin(turn)))


def wet_zone(rng: np.random.Generator, radius: float, middle: float, span: float) -> Inclusion:
    """Draw a wet zone near the rows, longer around the centre than outwards."""
    turn, at = _place(rng, 0.1 * radius, 0.5 * radius)
    half = rng.uniform(0.12, 0.25) * radius, rng.uniform(0.06, 0.12) * radius, rng.uniform(0.2, 0.8) * span
    height = middle + span * float(rng.uniform(-0.5, 0.5))
    density = WET_PER_MM * float(rng.uniform(0.6, 1.4))
    return Inclusion(
        "wet zone", height, at, half, (True, True), turn + TAU / 4.0, density, rng.uniform(-0.002, 0.002), 0.12
    )


def cracks(rng: np.random.Generator, radius: float, middle: float, span: float) -> Iterator[Inclusion]:
    """Draw one to three radial cracks, 1 to 3 mm wide; none reaches the pith, where another one would be."""
    count, first = int(rng.integers(1, 4)), rng.uniform(0.0, TAU)
    for number in range(count):
        half = rng.uniform(0.1, 0.25) * radius, rng.uniform(0.5, 1.5), rng.uniform(0.3, 1.0) * span
        out = half[0] + rng.uniform(0.06, 0.2) * radius
        turn = first + TAU * number / count + rng.uniform(-0.5, 0.5)
        yield Inclusion(
            "crack",
            middle + span * float(rng.uniform(-0.5, 0.5)),
            (float(out * math.cos(turn)), float(out * math.sin(turn))),
            half,
            (True, False),
            float(turn),
            CRACK_PER_MM,
            rng.uniform(-0.003, 0.003),
        )


def nail(rng: np.random.Generator, radius: float, height_mm: float) -> Inclusion:
    """Draw a nail, as wide at its ends as in its middle."""
    turn, at = _place(rng, 0.35 * radius, 0.75 * radius)
    half = rng.uniform(2.4, 3.2), rng.uniform(1.8, 2.4), 0.5 * NAIL_MM
    height = height_mm + float(rng.uniform(-2.0, 2.0))
    return Inclusion("nail", height, at, half, (False, False), turn, NAIL_PER_MM - SAPWOOD_PER_MM)


def small_knot(rng: np.random.Generator, radius: float, height_mm: float) -> Inclusion:
    """Draw a branch across the axis, round as seen from its tip."""
    turn, at = _place(rng, 0.4 * radius, 0.65 * radius)
    half = rng.uniform(15.0, 25.0), 0.5 * SMALL_KNOT_MM, 0.5 * SMALL_KNOT_MM
    height = height_mm + float(rng.uniform(-2.0, 2.0))
    return Inclusion("knot", height, at, half, (False, True), turn, KNOT_PER_MM - 0.012)
