"""The price of a slice by total variation, and how far it ends from its minimum.

A block of sixteen unlike slices (simulated logs of three kinds, `choosing.py`), 256 x 256 pixels, 768 cells, its weight
given. Prints processor seconds a slice on one thread and on all, with the iterations of the last level and the error
compared with the same objective's at rest (a hundred iterations more).

    python benchmarks/slice_price.py [--views 20] [--noise 0.02] [--weight-share 4] [--repeats 3]
"""

import argparse
import time

import numpy as np
from choosing import smooth_log, zoned_log
from numba import get_num_threads, set_num_threads
from scanners import SCANNER
from scans import GRID, TRUE_THETA

from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import total_variation

BLOCK = 16
AT_REST = {"tolerance": 1e-6, "iterations": 150}


def logs() -> list[Phantom]:
    """List logs with rings of real wood, broad zones and smooth rings in turn."""
    rng = np.random.default_rng(1)
    found = []
    for index in range(BLOCK):
        model = LogModel.random(int(rng.integers(1000)), radius_mm=rng.uniform(100.0, 140.0))
        height = rng.uniform(150.0, 250.0)
        found.append((model.slice_at(height), zoned_log(rng), smooth_log(rng))[index % 3])
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--weight-share", type=float, default=4.0, help="the weight times the wood's attenuation")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(options.views) + 0.5) * TAU / options.views)
    projector, bodies = Projector(geometry, GRID), logs()
    lines = projector.block(
        np.stack([simulate_sinogram(b, geometry, noise=options.noise, seed=n) for n, b in enumerate(bodies)])
    )
    truths = [body.rasterise(GRID.size, GRID.field_mm) for body in bodies]
    weight = options.weight_share / SAPWOOD_PER_MM
    total_variation(projector, lines, weight=weight, iterations=1)
    rest = total_variation(projector, lines, weight=weight, **AT_REST)
    least = np.array([relative_error(image, truth) for image, truth in zip(rest.image, truths, strict=True)])
    for threads in sorted({1, get_num_threads()}):
        set_num_threads(threads)
        laps = []
        for _ in range(options.repeats):
            started, used = time.perf_counter(), time.process_time()
            found = total_variation(projector, lines, weight=weight)
            laps.append((time.process_time() - used, time.perf_counter() - started))
        processor, clock = (1e3 * np.min(laps, axis=0) / BLOCK).tolist()
        errors = np.array([relative_error(image, truth) for image, truth in zip(found.image, truths, strict=True)])
        print(
            f"{options.views} views, {100.0 * options.noise:g} % noise, {threads} threads: {processor:.1f} ms of "
            f"processor, {clock:.1f} ms by the clock a slice; {found.iterations.mean():.1f} iterations; error "
            f"{errors.mean():.4f}, {errors.mean() / least.mean():.4f} of that at rest, {(errors / least).max():.3f} at "
            "most"
        )


if __name__ == "__main__":
    main()
