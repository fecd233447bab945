"""Images of logs that are turned between passages, so that each view has a shift and a roll of its own.

Simulated logs with the rings of real wood, every second one cut through a whorl of knots; analytic data, 2 % noise.
Shifts along and across the beam and rolls are normal; their standard deviations are drawn for each log, up to the
options. Each log is reconstructed as `auto` does it, with its true poses, without poses and with those that
`find_view_poses` finds; with these also with the ring weight that is chosen without poses, which tells the effect of
the poses from the choice's. Errors are relative, after the best common shift and turn of the image. Prints a line for
each log, and writes `results/log-poses.json`.

    python benchmarks/log_poses.py [--logs 100] [--views 20] [--size 192] [--shift-mm 2] [--roll-deg 0.5]
"""

import argparse
import math
import time

import numpy as np
from measurement import Measurement
from scanners import SCANNER
from scans import GRID, LOG_NOISE, TRUE_THETA

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FanViews, FloatArray, Scanner, rotate
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.reconstruction.choosing import recommend
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import ring_tv
from sawmill_tomography.reconstruction.view_poses import find_view_poses
from sawmill_vocabulary import ReconstructionMethod

SEED = 5100
CELLS_A_PIXEL = 3
# Least standard deviations of the poses.
LEAST_SHIFT_MM, LEAST_ROLL_RAD = 0.1, math.radians(0.05)


def simulated_log(index: int, rng: np.random.Generator) -> Phantom:
    """Draw a log's slice somewhere near the centre of rotation."""
    radius_mm = float(rng.uniform(100.0, 165.0))
    log = LogModel.random(SEED + index, radius_mm=radius_mm).slice_at(120.0 if index % 2 else 180.0)
    return log.moved(*rng.uniform(-8.0, 8.0, 2))


def simulated_views(
    log: Phantom, geometry: FanBeamGeometry, shift_mm: FloatArray, roll_rad: FloatArray, rng: np.random.Generator
) -> Image:
    """Simulate the line integrals of a log that rolls about the COR in each view, and is then shifted (views, 2)."""
    turned_back = np.stack(rotate(-roll_rad, *shift_mm.T), -1)
    cells, angles = DetectorCells.of(geometry.scanner), geometry.angles_rad - roll_rad
    lines = analytic.project(log, cells, geometry.frame, angles, position_mm=turned_back, rays_per_cell=4)
    noisy = lines + LOG_NOISE * math.sqrt(np.mean(lines**2)) * rng.standard_normal(lines.shape)
    return np.asarray(noisy, np.float32)


def moved_error(image: Image, log: Phantom, grid: ImageGrid) -> float:
    """Compute an image's relative error after the best common shift and turn."""
    truth = log.rasterise(grid.size, grid.field_mm, subsamples=3)
    to_x, to_y = (-each for each in np.gradient(truth.astype(np.float64), grid.pixel_mm))
    turn = grid.x_mm[:, None] * to_y - grid.y_mm * to_x
    slopes = np.stack([to_x, to_y, turn], -1).reshape(-1, 3)
    shift_x, shift_y, turn_rad = np.linalg.lstsq(slopes, (image - truth).ravel(), rcond=None)[0]
    moved = log.rotated(turn_rad).moved(shift_x, shift_y)
    return relative_error(image, moved.rasterise(grid.size, grid.field_mm, subsamples=3))


def measure(index: int, options: argparse.Namespace) -> dict[str, float]:
    """Measure one log's errors with true poses, without poses and with those found, and the remaining shifts."""
    rng = np.random.default_rng(SEED + index)
    log = simulated_log(index, rng)
    cells, views, grid = CELLS_A_PIXEL * options.size, options.views, ImageGrid(options.size, GRID.field_mm)
    pitch_mm = SCANNER.num_detector_pixels * SCANNER.detector_pitch_mm / cells
    scanner = Scanner(SCANNER.source_to_cor_mm, cells, pitch_mm)
    geometry = FanBeamGeometry(scanner, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
    shift_size = rng.uniform(min(LEAST_SHIFT_MM, options.shift_mm), options.shift_mm)
    roll_size = rng.uniform(min(LEAST_ROLL_RAD, math.radians(options.roll_deg)), math.radians(options.roll_deg))
    shift_mm, roll_rad = rng.normal(0.0, shift_size, (views, 2)), rng.normal(0.0, roll_size, views)
    lines = simulated_views(log, geometry, shift_mm, roll_rad, rng)
    started = time.process_time()
    poses = find_view_poses(geometry, lines[None])
    seconds = time.process_time() - started
    left = poses.across_mm - np.sum((shift_mm - shift_mm.mean(axis=0)) * geometry.axis, axis=1)

    def made(at: FanViews, ring_weight: float | None = None) -> tuple[float, float]:
        """Return the error of an image, and its ring weight."""
        method = recommend(at, lines, grid, fitted_size=grid.size).method
        assert method is ReconstructionMethod.RING_TV
        image = ring_tv(Projector(at, grid), lines, ring_weight=ring_weight)
        return moved_error(image.image, log, grid), float(image.parameters["ring_weight"][0])

    none, ring_weight = made(geometry)
    found, chosen = made(poses.of(geometry))
    return {
        "shift_mm": float(shift_size),
        "left_mm": float(np.sqrt(np.mean(left**2))),
        "true": made(geometry.moved(shift_mm - shift_mm.mean(axis=0), roll_rad - roll_rad.mean()))[0],
        "none": none,
        "found": found,
        "found_same_rings": found if chosen == ring_weight else made(poses.of(geometry), ring_weight)[0],
        "seconds": seconds,
    }


def main() -> None:
    """Print each log, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--size", type=int, default=192)
    parser.add_argument("--shift-mm", type=float, default=2.0)
    parser.add_argument("--roll-deg", type=float, default=0.5)
    options = parser.parse_args()
    measurement = Measurement.begin("worker/sawmill_tomography")
    rows = []
    for index in range(options.logs):
        rows.append(row := measure(index, options))
        print(index, " ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    of = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    to_true, to_none, same_rings = (
        of["found"] / of["true"],
        of["found"] / of["none"],
        of["found_same_rings"] / of["none"],
    )
    values = {
        "logs": options.logs,
        "views": options.views,
        "median_to_true_poses": float(np.median(to_true)),
        "largest_to_true_poses": float(to_true.max()),
        "median_to_no_poses": float(np.median(to_none)),
        "largest_to_no_poses": float(to_none.max()),
        "beyond_2_percent": int((to_none > 1.02).sum()),
        "largest_to_no_poses_same_rings": float(same_rings.max()),
        "median_no_to_true_poses": float(np.median(of["none"] / of["true"])),
        "median_shift_left_mm": float(np.median(of["left_mm"])),
        "largest_shift_left_mm": float(of["left_mm"].max()),
        "median_seconds": float(np.median(of["seconds"])),
    }
    print(values)
    measurement.write({"log-poses": values}, timed=False)


if __name__ == "__main__":
    main()
