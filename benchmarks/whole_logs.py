"""Simulated logs that change along the axis as real ones do, with the truth in hand: `WholeLog.random(seed)`.

A log is a `LogModel` with its rings whose pith wanders, whose centre bends and whose radius tapers from row to row, in
a bark of uneven thickness, a little elliptic. Whorls of knots rise as cones from the pith. Wet zones, cracks that turn
with the grain, a nail of 8 mm and a knot of 12 mm along the axis begin and end between the rows. The nail is below six
times the wood's attenuation, from which metal is treated apart: the method itself must keep it. The rows lie 2 to 4 mm
apart.

- **The truth** is each pixel's area mean, 4 x 4 points a pixel, in the plane of the row: (rows, size, size), 1/mm.
- **The data** are line integrals of the shapes themselves, polygons and discs, the mean of 8 rays a cell, in the plane
  of the row: no pixels are projected, and none of the projectors that reconstruct are used. Noise is Gaussian, relative
  to the RMS of each row.

Seeds from 4000 are for tuning, those from 4100 for tables (log_table.py).

    python benchmarks/whole_logs.py --seed 4100 --out FOLDER     the rows of a log side by side, as PNG
"""

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from inclusions import Inclusion, cracks, nail, small_knot, wet_zone
from numpy.typing import NDArray
from scans import GRID
from skimage.io import imsave

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Phantom, Polygon, Shape
from sawmill_tomography.projection.simulate import simulate_rows

TUNING_SEED, TABLE_SEED = 4000, 4100
ROWS, ROW_PITCHES_MM = 24, (2.0, 2.5, 3.0, 4.0)
BARK_PER_MM = 0.011
# Where the whorl that the rows are around starts (`LogModel.random`).
WHORL_MM = 180.0
Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Wander:
    """A position in the plane that changes slowly along the axis: two waves in each direction."""

    waves: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def random(cls, rng: np.random.Generator, most_mm: float) -> "Wander":
        """Draw wave lengths of 120 to 500 mm; `most_mm` off the mean at most."""
        return cls(
            tuple(
                (direction, 0.5 * most_mm * rng.uniform(0.3, 1.0), TAU / rng.uniform(120.0, 500.0), rng.uniform(0, TAU))
                for direction in (0.0, 0.0, 1.0, 1.0)
            )
        )

    def at(self, height_mm: float) -> tuple[float, float]:
        """Return millimetres in x and in y."""
        found = [0.0, 0.0]
        for direction, size, frequency, phase in self.waves:
            found[int(direction)] += size * math.sin(frequency * height_mm + phase)
        return found[0], found[1]


@dataclass(frozen=True)
class WholeLog:
    """A log; equal seeds give equal logs.

    Attributes
    ----------
    heights_mm : tuple of float
        Heights of the rows.
    inclusions : tuple of Inclusion
        The last two are the nail and the small knot.
    """

    seed: int
    heights_mm: tuple[float, ...]
    wood: LogModel
    taper: float
    centre: Wander
    pith: Wander
    bark_mm: float
    bark: Wander
    aspect: tuple[float, float]
    inclusions: tuple[Inclusion, ...]

    @classmethod
    def random(cls, seed: int, *, rows: int = ROWS, row_pitch_mm: float | None = None) -> "WholeLog":
        """Draw a log by the seed, its rows around a whorl; the pitch is drawn by default."""
        rng = np.random.default_rng(seed)
        pitch = float(rng.choice(ROW_PITCHES_MM)) if row_pitch_mm is None else row_pitch_mm
        radius = float(rng.uniform(95.0, 150.0))
        middle = WHORL_MM + float(rng.uniform(-12.0, 25.0))
        heights = tuple(middle + pitch * (row - 0.5 * (rows - 1)) for row in range(rows))
        wood = LogModel.random(seed, radius_mm=radius)
        # No metal but the nail below.
        wood = replace(wood, metal_height_mm=math.inf)
        span = rows * pitch
        return cls(
            seed=seed,
            heights_mm=heights,
            wood=wood,
            taper=float(rng.uniform(0.004, 0.012)),
            centre=Wander.random(rng, 12.0),
            pith=Wander.random(rng, 0.06 * radius),
            bark_mm=float(rng.uniform(4.0, 10.0)),
            bark=Wander.random(rng, 2.5),
            aspect=(float(rng.uniform(-0.06, 0.06)), float(rng.uniform(-0.06, 0.06))),
            inclusions=(
                *(wet_zone(rng, radius, middle, span) for _ in range(rng.integers(1, 4))),
                *cracks(rng, radius, middle, span),
                nail(rng, radius, middle - 0.25 * span),
                small_knot(rng, radius, middle + 0.25 * span),
            ),
        )

    @property
    def row_pitch_mm(self) -> float:
        """Distance from row to row, mm."""
        return self.heights_mm[1] - self.heights_mm[0] if len(self.heights_mm) > 1 else ROW_PITCHES_MM[0]

    def slice_at(self, height_mm: float) -> Phantom:
        """Return the cross-section at a height, densities in attenuation per mm."""
        radius = self.wood.radius_mm * (1.0 - self.taper * (height_mm - self.heights_mm[0]) / 100.0)
        wander = self.pith.at(height_mm)
        pith = self.wood.pith_mm[0] + wander[0], self.wood.pith_mm[1] + wander[1]
        wood = replace(self.wood, radius_mm=radius, pith_mm=pith)
        outline = wood.outline(1.0)
        bark = Phantom("bark", (Polygon(outline, BARK_PER_MM),)).scaled(1.0 + self.bark_mm / radius)
        shapes: list[Shape] = [
            *bark.moved(*self.bark.at(height_mm)).shapes,
            Polygon(outline, -BARK_PER_MM),
            *wood.slice_at(height_mm).shapes,
        ]
        cuts = (inclusion.cut(height_mm) for inclusion in self.inclusions)
        shapes += [cut for cut in cuts if cut is not None]
        body = Phantom(f"log {self.seed} at {height_mm:.1f} mm", tuple(shapes))
        return body.deformed(*self.aspect).moved(*self.centre.at(height_mm))

    @property
    def slices(self) -> list[Phantom]:
        """The cross-sections of all rows."""
        return [self.slice_at(height) for height in self.heights_mm]

    def truth(self, grid: ImageGrid = GRID) -> Rows:
        """Return (rows, size, size) float32, each pixel its area mean, in attenuation per mm."""
        return np.stack([body.rasterise(grid.size, grid.field_mm) for body in self.slices])

    def sinograms(self, geometry: FanBeamGeometry, *, noise: float) -> Rows:
        """Simulate (rows, views, detector) float32, line integrals; the noise relative to the RMS of each row."""
        found = simulate_rows(self.slices, geometry, noise=noise, seed=1000 * self.seed)
        return np.ascontiguousarray(found.transpose(1, 0, 2))

    def inclusion_alone(self, name: str, grid: ImageGrid = GRID) -> Rows:
        """Compute the share of each pixel that the nail, or the small knot, takes: (rows, size, size) float32."""
        found = np.zeros((len(self.heights_mm), grid.size, grid.size), np.float32)
        only = next(inclusion for inclusion in self.inclusions if inclusion.name == name)
        for row, height in enumerate(self.heights_mm):
            cut = replace(only, density=1.0).cut(height)
            if cut is not None:
                body = Phantom(name, (cut,)).deformed(*self.aspect).moved(*self.centre.at(height))
                found[row] = body.rasterise(grid.size, grid.field_mm)
        return found


def main() -> None:
    """Draw the rows of a log side by side."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=TABLE_SEED)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--shown", type=int, default=8)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    log = WholeLog.random(asked.seed, rows=asked.rows)
    shown = [log.heights_mm[row] for row in np.linspace(0, asked.rows - 1, asked.shown).round().astype(int)]
    images = np.stack([log.slice_at(height).rasterise(GRID.size, GRID.field_mm) for height in shown])
    halves: list[FloatArray] = [np.hstack(half) for half in np.array_split(images, 2)]
    picture = np.clip(np.vstack(halves) / (1.5 * SAPWOOD_PER_MM), 0.0, 1.0)
    asked.out.mkdir(parents=True, exist_ok=True)
    imsave(asked.out / f"log-{asked.seed}.png", (255.0 * picture).astype(np.uint8), check_contrast=False)


if __name__ == "__main__":
    main()
