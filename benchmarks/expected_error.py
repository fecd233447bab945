"""Expected error of each reconstruction method, by views and noise: the table that `auto` chooses by.

Simulated logs with the rings of real wood, every second one cut through a whorl of knots; analytic data averaged over
the detector's cells, three cells a pixel, the published scanner's theta, equal steps all round. Each method chooses
its own parameters. The figure is the relative error, its geometric mean over the logs. Prints a row for each method,
number of views and noise, and at the end the table as `EXPECTED_ERRORS` of
worker/sawmill_tomography/reconstruction/choosing.py has it. With --check `auto` chooses for ten other logs, for the CT
slice of tree_disc.py and for the published log, both in the folder that SAWMILL_PUBLISHED_DATA names: prints expected
and real error, and ratio, and writes results/expected-error.json.

    python benchmarks/expected_error.py [--logs 6] [--size 256] [--methods fbp,...] [--views 20 45] [--check]
"""

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product

import numpy as np
import tree_disc
from measurement import Measurement
from scanners import SCANNER
from scans import ANGLES, GRID, TRUE_THETA, log_sinogram, log_truth

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Scanner
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Image, Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.cauchy_map import cauchy_map
from sawmill_tomography.reconstruction.choosing import NOISES, VIEWS, recommend
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.tikhonov import tikhonov
from sawmill_tomography.reconstruction.total_variation import ring_tv, total_variation
from sawmill_vocabulary import ReconstructionMethod

FIELD_MM, DETECTOR_MM = GRID.field_mm, SCANNER.num_detector_pixels * SCANNER.detector_pitch_mm
CELLS_A_PIXEL = 3
METHODS: Mapping[ReconstructionMethod, Callable[..., Estimate]] = {
    ReconstructionMethod.FBP: fbp,
    ReconstructionMethod.TIKHONOV: tikhonov,
    ReconstructionMethod.TOTAL_VARIATION: total_variation,
    ReconstructionMethod.RING_TV: ring_tv,
    ReconstructionMethod.CAUCHY_MAP: cauchy_map,
}
# Seed of the logs and their noise; of the logs that check the table, their views and noises.
SEED, CHECK_SEED = 9600, 9700
CHECK_LOGS, CHECK_VIEWS, CHECK_NOISES = 10, (12, 20, 45, 90), (0.005, 0.02)
WITHIN, PROCESSES = 0.2, 2


def simulated_log(seed: int) -> Phantom:
    """Draw a log's slice: through a whorl, in clear wood, ..."""
    log = LogModel.random(seed, radius_mm=float(np.random.default_rng(seed).uniform(100.0, 165.0)))
    return log.slice_at(120.0 if seed % 2 else 180.0)


def scan_of(seed: int, views: int, noise: float, size: int) -> tuple[Projector, FloatArray, Image]:
    """Return the projector, the sinogram (views, cells) and the truth of one log."""
    cells = CELLS_A_PIXEL * size
    scanner = Scanner(SCANNER.source_to_cor_mm, cells, DETECTOR_MM / cells)
    geometry = FanBeamGeometry(scanner, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
    log, grid = simulated_log(seed), ImageGrid(size, FIELD_MM)
    sinogram = simulate_sinogram(log, geometry, noise=noise, seed=seed)
    return Projector(geometry, grid), sinogram, log.rasterise(size, FIELD_MM)


def error(method: ReconstructionMethod, seed: int, views: int, noise: float, size: int) -> float:
    """Compute the relative error of one log's image."""
    projector, sinogram, truth = scan_of(seed, views, noise, size)
    return relative_error(METHODS[method](projector, sinogram).image, truth)


def measure(methods: Sequence[ReconstructionMethod], all_views: Sequence[int], logs: int, size: int) -> None:
    """Print each row as it is measured, and the table."""
    table: dict[ReconstructionMethod, list[list[float]]] = {}
    for method in methods:
        for views in all_views:
            row = []
            for noise in NOISES:
                started = time.perf_counter()
                errors = [error(method, SEED + index, views, noise, size) for index in range(logs)]
                row.append(round(float(np.exp(np.mean(np.log(errors)))), 4))
                each = " ".join(f"{one:.4f}" for one in errors)
                print(f"{method:16s}{views:4d} views {noise:.3f}: {row[-1]:.4f}  ({each})", end="  ")
                print(f"{time.perf_counter() - started:.1f} s", flush=True)
            table.setdefault(method, []).append(row)
    for method, rows in table.items():
        print(f"    ReconstructionMethod.{method.name}: (")
        for row in rows:
            print(f"        ({', '.join(f'{value:g}' for value in row)}),")
        print("    ),")


def check(size: int) -> None:
    """Compare the error that `auto` expects with the real one, and write the figures."""
    measurement = Measurement.begin("worker/sawmill_tomography/phantoms", "worker/sawmill_tomography/reconstruction")
    values: dict[str, float | str] = {"source": "published"}
    scans = list(product(range(CHECK_SEED, CHECK_SEED + CHECK_LOGS), CHECK_VIEWS, CHECK_NOISES))
    with ProcessPoolExecutor(PROCESSES) as pool:
        values |= summary("logs", list(pool.map(partial(checked_log, size=size), *zip(*scans, strict=True))))
        values |= summary("disc", list(pool.map(checked_disc, *zip(*product(CHECK_VIEWS, CHECK_NOISES), strict=True))))
    for views in CHECK_VIEWS[1:]:
        step = 360 // views
        projector = Projector(FanBeamGeometry(SCANNER, TRUE_THETA, ANGLES[::step]), GRID)
        compared(f"published log, {views} views", projector, log_sinogram("published")[::step], log_truth("published"))
    measurement.write({"expected-error": values}, timed=False)


def checked_log(seed: int, views: int, noise: float, size: int) -> float:
    """Return the real error of a simulated log over the expected one."""
    return compared(f"log {seed}, {views} views, {noise:g} noise", *scan_of(seed, views, noise, size))


def checked_disc(views: int, noise: float) -> float:
    """Return the real error of the CT slice over the expected one."""
    disc, pixel_mm, _ = tree_disc.read_disc()
    scan = tree_disc.scan_of(disc, pixel_mm, views, noise)
    return compared(f"CT slice, {views} views, {noise:g} noise", *scan, tree_disc.halved(disc))


def summary(name: str, ratios: Sequence[float]) -> dict[str, float | str]:
    """Count the scans whose error is within 20 % of the expected one, and write the range."""
    values = {
        f"{name}_scans": len(ratios),
        f"{name}_within": sum(abs(ratio - 1.0) <= WITHIN for ratio in ratios),
        f"{name}_range": f"{min(ratios):.2f} to {max(ratios):.2f}",
    }
    print(values)
    return values


def compared(name: str, projector: Projector, sinogram: FloatArray, truth: FloatArray) -> float:
    """Print the expected and the real error of the method that `auto` takes; return their ratio."""
    chosen = recommend(projector.geometry, sinogram, projector.grid, fitted_size=projector.grid.size)
    found = relative_error(METHODS[chosen.method](projector, sinogram).image, truth)
    ratio = found / (chosen.expected_error or math.nan)
    print(f"{name}: {chosen.method}, expected {chosen.expected_error:.4f}, real {found:.4f}, {ratio:.2f}", flush=True)
    return ratio


def main() -> None:
    """Print the table, or the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=6)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--methods", type=lambda text: [ReconstructionMethod(name) for name in text.split(",")])
    parser.add_argument("--views", type=int, nargs="+", default=VIEWS)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    methods = options.methods or list(METHODS)
    if options.check:
        check(options.size)
    else:
        measure(methods, options.views, options.logs, options.size)


if __name__ == "__main__":
    main()
