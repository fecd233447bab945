"""The product's parts compared with their peers and the machine's limits, one after the other in one process.

    python benchmarks/speed.py

Writes `benchmarks/results/speed.json`.

Total variation is compared with ASTRA's SIRT on one core, stopped where its error is least. Drift checks and starts
have no peer. A limit is what the multiply-adds that cannot be left out take at the rate of a matrix product on all
cores: two of each pixel (FBP), or two of each pixel's width along each ray (iterations). Starts are processes: of the
command line, in processor seconds, and of a service until it is ready. `calibration_speed.py` measures calibrations,
`reconstruction_speed.py` compares filtered back-projection with ODL.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from astra_rivals import STOPS, tuned
from measurement import Measurement
from numpy.typing import DTypeLike
from reconstruction_speed import from_counts
from scanners import SCANNER
from scans import GRID, TRUE_THETA
from slice_price import BLOCK, logs

from sawmill_command.demo_client import running_service
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import USUAL_PAIRS, total_variation
from sawmill_vocabulary import Rotation


def median_s(run: Callable[[], object], repeats: int = 7) -> float:
    """Return the median seconds by the clock; a run before them is not counted."""
    laps = []
    for _ in range(repeats + 1):
        started = time.perf_counter()
        run()
        laps.append(time.perf_counter() - started)
    return float(np.median(laps[1:]))


def multiply_add_s(kind: DTypeLike) -> float:
    """Return the seconds of a multiply-add in a product of matrices of 2048 x 2048, all cores at work."""
    size = 2048
    matrix = np.random.default_rng(1).standard_normal((size, size)).astype(kind)
    return median_s(lambda: matrix @ matrix) / size**3


def started_s(*arguments: str) -> float:
    """Return the median processor seconds of `sawmill` as a process; a run before is not counted."""
    command = [str(Path(sys.executable).parent / "sawmill"), *arguments]
    laps = []
    for _ in range(6):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        laps.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return float(np.median(laps[1:]))


def ready_s() -> float:
    """Return the median seconds until `sawmill serve` is ready on an empty data folder, after one uncounted start."""
    laps = []
    for _ in range(4):
        with tempfile.TemporaryDirectory(prefix="sawmill-speed-") as folder:
            started = time.perf_counter()
            with running_service(Path(folder)):
                laps.append(time.perf_counter() - started)
    return float(np.median(laps[1:]))


def block_of_slices(slices: int = 64) -> dict[str, float]:
    """Return the milliseconds a slice from counts to the image, 360 views, and the back-projection's limit."""
    views, size = 360, 256
    projector = Projector(
        FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views), ImageGrid(size, 400.0)
    )
    once = median_s(from_counts(projector, slices)) / slices
    return {"a_slice_ms": 1e3 * once, "limit_ms": 1e3 * 2 * views * size**2 * multiply_add_s(np.float32)}


def few_views_slices() -> dict[str, float]:
    """Return milliseconds a slice by total variation, 20 views at 2 % noise, and by ASTRA's SIRT; errors."""
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(20) + 0.5) * TAU / 20)
    projector, bodies = Projector(geometry, GRID), logs()
    sinograms = [simulate_sinogram(body, geometry, noise=0.02, seed=number) for number, body in enumerate(bodies)]
    lines, truths = projector.block(np.stack(sinograms)), [body.rasterise(GRID.size, GRID.field_mm) for body in bodies]
    found = total_variation(projector, lines, weight=4.0 / SAPWOOD_PER_MM)
    once = median_s(lambda: total_variation(projector, lines, weight=4.0 / SAPWOOD_PER_MM)) / BLOCK
    peer = tuned("SIRT", projector, np.stack(sinograms).astype(np.float32), np.stack(truths), STOPS["SIRT"])
    # Two pixels share a ray's crossing of a row of pixels, forward and back.
    crossings = 4.0 * USUAL_PAIRS * geometry.sinogram_shape[0] * geometry.sinogram_shape[1] * GRID.size
    errors = [relative_error(image, truth) for image, truth in zip(found.image, truths, strict=True)]
    peers = [relative_error(image, truth) for image, truth in zip(peer.images, truths, strict=True)]
    return {
        "a_slice_ms": 1e3 * once,
        "sirt_ms": 1e3 * peer.wall_s,
        "ratio": peer.wall_s / once,
        "limit_ms": 1e3 * crossings * multiply_add_s(np.float32),
        "error": float(np.mean(errors)),
        "sirt_error": float(np.mean(peers)),
    }


def drift_check_s(views: int) -> float:
    """Return the median seconds of the fit of one drift check of a simulated log, its rows averaged already."""
    geometry = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
    rays = simulate_sinogram(LogModel.random(views).slice_at(120.0), geometry, noise=0.005, seed=views)
    start = TRUE_THETA.source_frame(SCANNER.source_to_cor_mm)
    start = replace(start, cor_column_mm=start.cor_column_mm + 0.3)
    return median_s(lambda: detector_fit(SCANNER, rays, geometry.angles_rad, start, Rotation.AS_GIVEN))


def main() -> None:
    """Print the figures and write them."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    measurement = Measurement.begin(
        "worker/sawmill_tomography/drift", "worker/sawmill_tomography/reconstruction", "service/sawmill_command"
    )
    values: dict[str, dict[str, float]] = {}
    values["fbp_block"], values["total_variation"] = block_of_slices(), few_views_slices()
    values["drift_check"] = {f"views_{views}_s": drift_check_s(views) for views in (20, 45, 120, 360)}
    values["start"] = {f"{name}_processor_s": started_s(f"--{name}") for name in ("version", "help")}
    values["start"]["ready_s"] = ready_s()
    for name, figures in values.items():
        print(f"{name}: {', '.join(f'{key} {value:.3g}' for key, value in figures.items())}")
    measurement.write({"speed": values})


if __name__ == "__main__":
    main()
