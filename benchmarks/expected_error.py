"""Expected error of each reconstruction method, by views and noise: the table that `auto` chooses by.

Simulated logs with the rings of real wood, every second one cut through a whorl of knots; analytic data averaged over
the detector's cells, three cells a pixel, the published scanner's theta, equal steps all round. Each method chooses
its own parameters. The figure is the relative error, its geometric mean over the logs. Prints a row for each method,
number of views and noise, and at the end the table as `EXPECTED_ERRORS` of
worker/sawmill_tomography/reconstruction/choosing.py has it. With --published the same methods reconstruct the
published log (256 x 256, 2 % noise; see SAWMILL_PUBLISHED_DATA) compared with the table's values.

    python benchmarks/expected_error.py [--logs 3] [--size 256] [--methods fbp,...] [--views 20 45] [--published]
"""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scanners import SCANNER
from scans import ANGLES, GRID, TRUE_THETA, log_sinogram, log_truth

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, Scanner
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.cauchy_map import cauchy_map
from sawmill_tomography.reconstruction.choosing import NOISES, VIEWS, comparable_noise, expected_error, noise_share
from sawmill_tomography.reconstruction.estimate import Estimate
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
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
# Seed of the logs and their noise.
SEED = 9600


def simulated_log(index: int) -> Phantom:
    """Draw a log's slice: through a whorl, in clear wood, ..."""
    rng = np.random.default_rng(SEED + index)
    log = LogModel.random(SEED + index, radius_mm=float(rng.uniform(100.0, 165.0)))
    return log.slice_at(120.0 if index % 2 else 180.0)


def error(method: ReconstructionMethod, index: int, views: int, noise: float, size: int) -> float:
    """Compute the relative error of one log's image."""
    cells = CELLS_A_PIXEL * size
    scanner = Scanner(SCANNER.source_to_cor_mm, cells, DETECTOR_MM / cells)
    geometry = FanBeamGeometry(scanner, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
    log = simulated_log(index)
    sinogram = simulate_sinogram(log, geometry, noise=noise, seed=SEED + index)
    found = METHODS[method](Projector(geometry, ImageGrid(size, FIELD_MM)), sinogram)
    return relative_error(found.image, log.rasterise(size, FIELD_MM))


def measure(methods: Sequence[ReconstructionMethod], all_views: Sequence[int], logs: int, size: int) -> None:
    """Print each row as it is measured, and the table."""
    table: dict[ReconstructionMethod, list[list[float]]] = {}
    for method in methods:
        for views in all_views:
            row = []
            for noise in NOISES:
                started = time.perf_counter()
                errors = [error(method, index, views, noise, size) for index in range(logs)]
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


def check_published(methods: Sequence[ReconstructionMethod], all_views: Sequence[int]) -> None:
    """Compare the error on the published log with the table's."""
    truth = log_truth("published")
    for views in all_views:
        step = 360 // views
        geometry, lines = FanBeamGeometry(SCANNER, TRUE_THETA, ANGLES[::step]), log_sinogram("published")[::step]
        noise = comparable_noise(geometry, GRID, noise_share(lines))
        for method in methods:
            image = METHODS[method](Projector(geometry, GRID), lines).image
            print(
                f"published log, {views:3d} views, {method:16s}: relative error {relative_error(image, truth):.4f}, "
                f"expected {expected_error(method, views, noise):.4f}, "
                f"SSIM {structural_similarity_index(image, truth):.3f}",
                flush=True,
            )


def main() -> None:
    """Print the table, or the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=3)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--methods", type=lambda text: [ReconstructionMethod(name) for name in text.split(",")])
    parser.add_argument("--views", type=int, nargs="+", default=VIEWS)
    parser.add_argument("--published", action="store_true")
    options = parser.parse_args()
    methods = options.methods or list(METHODS)
    if options.published:
        check_published(methods, options.views)
    else:
        measure(methods, options.views, options.logs, options.size)


if __name__ == "__main__":
    main()
