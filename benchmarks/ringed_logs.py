"""Simulated logs with the rings of real wood: early and late wood, ring widths and densities by measured moments.

The median width and the contrast are of the CT slice of a tree (docs/understand/wood.md), the spread of widths, their
correlation, the late wood's share and the rings' densities of three increment cores (UGent-Woodlab, XCT.read), the
pith's distance of a fir's section (M. Ishida, TreeRingShape). Outlines are circles.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.phantoms.log_model import HEARTWOOD_PER_MM, SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Disc, Shape

# Median width, standard deviation of its logarithm, correlation of a ring's logarithm with the next one's.
RING_MM, RING_SPREAD, RING_CORRELATION = 3.3, 0.5, 0.7
# The late wood's share of a ring; its density above the ring's mean, the early wood's below it, and the rings' standard
# deviation, relative.
LATE_SHARE, LATE_DENSER, EARLY_LIGHTER, DENSITY_SPREAD = 0.42, 0.16, 0.12, 0.07
# The pith's distance from the outline's centre along x and y, at most, in radii.
PITH_REACH = 0.1
# Heartwood's share of the radius.
HEARTWOOD = 0.62


@dataclass(frozen=True)
class RingedLog(LogModel):
    """A simulated log whose concentric rings are replaced by rings of real wood."""

    # (radius in radii of the log, relative density within it) of each step, from the bark inwards
    steps: tuple[tuple[float, float], ...] = ()

    @classmethod
    def random(cls, seed: int, *, radius_mm: float = 130.0, length_mm: float = 400.0) -> "RingedLog":
        """Make a log; equal seeds give equal logs."""
        log, rng = LogModel.random(seed, radius_mm=radius_mm, length_mm=length_mm), np.random.default_rng((seed, 1))
        pith = rng.uniform(-PITH_REACH, PITH_REACH, 2) * radius_mm
        moved = replace(log, pith_mm=(float(pith[0]), float(pith[1])))
        return cls(**{**vars(moved), "steps": _random_steps(rng, radius_mm)})

    def _ring_discs(self) -> list[Shape]:
        """Return the steps of density at the borders of early and late wood, as discs."""
        discs, outside = list[Shape](), 0.0
        for radius, density in self.steps:
            here = density * (HEARTWOOD_PER_MM if radius < HEARTWOOD else SAPWOOD_PER_MM)
            discs.append(Disc(self._toward_pith(radius), radius * self.radius_mm, here - outside))
            outside = here
        return discs


def _random_steps(rng: np.random.Generator, radius_mm: float) -> tuple[tuple[float, float], ...]:
    """Draw rings from the bark to the pith: widths are log-normal and follow one another."""
    steps, outer, deviation = list[tuple[float, float]](), 1.0, rng.standard_normal()
    while True:
        width = RING_MM / radius_mm * math.exp(RING_SPREAD * deviation)
        if outer - width < 0.02:
            return tuple(steps)
        mean = DENSITY_SPREAD * rng.standard_normal()
        steps += [(outer, mean + LATE_DENSER), (outer - LATE_SHARE * width, mean - EARLY_LIGHTER)]
        outer -= width
        deviation = RING_CORRELATION * deviation + math.sqrt(1.0 - RING_CORRELATION**2) * rng.standard_normal()
