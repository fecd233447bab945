"""The product compared with its peers and the machine's limits, one after the other in one process.

    python benchmarks/speed.py [--full]

Writes `benchmarks/results/speed.json`.

Calibrations of the L-phantom's scan are compared with the published pipeline, filtered back-projection with ODL, and
total variation with ASTRA's SIRT on one core, stopped where its error is least. Drift checks have no peer. A limit is
what the multiply-adds that cannot be left out take at the rate of a matrix product on all cores: of a calibration the
inner products of its joint fit, of an image two of each pixel (FBP) or of each pixel's width along each ray
(iterations).

Without --full the published search is not run to its end: the time of one evaluation is measured and multiplied by the
evaluations that such a search took when it was run (4 389 with 360 views, 3 498 with 20). The product's time is
`timing_s.total`, from the sinogram in memory to the complete answer with its uncertainty, warm; and from the shell,
by the clock and in processor seconds, as the other starts are: of the command line, and of a service until it is ready.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from astra_rivals import STOPS, tuned
from measurement import Measurement
from mill_logs import Mill
from numpy.typing import DTypeLike
from published_pipeline import PublishedObjective, search
from reconstruction_speed import from_counts
from scanners import SCANNER
from scans import GRID, TRUE_THETA
from scipy.io import loadmat
from slice_price import BLOCK, logs

from sawmill_command.demo_client import running_service
from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.joint_fit.scan_model import Term
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry, FloatArray, Theta, to_vector
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.reconstruction.quality import relative_error
from sawmill_tomography.reconstruction.total_variation import USUAL_PAIRS, total_variation
from sawmill_vocabulary import Rotation

THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
MEASURED_EVALUATIONS = {360: 4389, 20: 3498}
REPEATS = 15


def published_file() -> Path:
    """Return the path of the published L-phantom, which may be absent."""
    return Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "l-phantom" / "sinogram.mat"


def l_phantom() -> tuple[str, FloatArray]:
    """Return the published sinogram (360, 768), or a simulated one of the same scanner where it is absent."""
    path = published_file()
    if path.is_file():
        return "published L-phantom", loadmat(path)["arr"].astype(np.float64)
    frame = THETA.source_frame(SCANNER.source_to_cor_mm)
    angles = (np.arange(360) + 0.5) * TAU / 360
    return "simulated L-phantom", analytic.project(L_SHAPE, DetectorCells.of(SCANNER), frame, angles, rays_per_cell=1)


def published_seconds(sinogram: FloatArray, *, full: bool) -> tuple[float, float, str]:
    """Return the seconds of one evaluation and of the whole search, and how the latter is known."""
    objective = PublishedObjective(SCANNER, L_SHAPE, sinogram)
    vector = to_vector(THETA)
    objective(vector)
    laps = []
    for _ in range(5):
        started = time.perf_counter()
        objective(vector)
        laps.append(time.perf_counter() - started)
    once = float(np.median(laps))
    if not full:
        evaluations = MEASURED_EVALUATIONS[len(sinogram)]
        return once, once * evaluations, f"{evaluations} evaluations, not run"
    started = time.perf_counter()
    outcome = search(objective, seed=7)
    seconds = time.perf_counter() - started
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    found = Theta.from_vector(outcome.x).source_frame(SCANNER.source_to_cor_mm)
    error = ray_error(SCANNER, true, found).rms_mm
    return once, seconds, f"{outcome.nfev} evaluations run, ray error {error:.3f} mm"


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


def product_seconds(sinogram: FloatArray, angles: FloatArray) -> tuple[dict[str, float], float, float]:
    """Return the median seconds of each stage, the limit of the whole, and the ray error."""
    calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles))
    runs = [calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles), seed=seed) for seed in range(REPEATS)]
    stages = {name: float(np.median([getattr(run.timing, name) for run in runs])) for name in vars(runs[0].timing)}
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    # Each round multiplies every two derivatives of the model, and each with the residual.
    rounds = float(np.median([run.findings.fit.iterations for run in runs]))
    limit = rounds * sinogram.size * len(Term) * (len(Term) + 3) / 2 * multiply_add_s(np.float64)
    return stages, limit, max(ray_error(SCANNER, true, run.frame).rms_mm for run in runs)


def from_the_shell(sinogram: FloatArray, folder: Path) -> tuple[float, float]:
    """Measure `sawmill calibrate` as a process, start and file included."""
    path = folder / f"{len(sinogram)}.npy"
    np.save(path, sinogram)
    step_deg = 360 // len(sinogram)
    options = ["--data", "line-integrals", "--angles-deg", f"0.5:{step_deg}", "--phantom", "l-shape", "--json"]
    options += ["--source-to-cor-mm", str(SCANNER.source_to_cor_mm)]
    options += ["--detector-pitch-mm", str(SCANNER.detector_pitch_mm)]
    return started_s("calibrate", str(path), *options)


def started_s(*arguments: str) -> tuple[float, float]:
    """Return the median seconds of `sawmill` as a process, by clock and processor; a run before is not counted."""
    command = [str(Path(sys.executable).parent / "sawmill"), *arguments]
    laps = []
    for _ in range(6):
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
        clock, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
        laps.append((clock, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    clock, processor = np.median(laps[1:], axis=0).tolist()
    return clock, processor


def ready_s() -> float:
    """Return the median seconds until `sawmill serve` is ready on an empty data folder, after one uncounted start."""
    laps = []
    for _ in range(4):
        with tempfile.TemporaryDirectory(prefix="sawmill-speed-") as folder:
            started = time.perf_counter()
            with running_service(Path(folder)):
                laps.append(time.perf_counter() - started)
    return float(np.median(laps[1:]))


def one_fbp(sinogram: FloatArray, angles: FloatArray) -> tuple[float, float]:
    """Return the median seconds of one 256 x 256 FBP: ODL's evaluation less its correlation, and ours."""
    objective = PublishedObjective(SCANNER, L_SHAPE, sinogram)
    projector = Projector(FanBeamGeometry(SCANNER, THETA, angles), ImageGrid(256, 400.0))
    laps: dict[str, list[float]] = {"odl": [], "ours": []}
    for _ in range(7):
        started = time.perf_counter()
        objective.image(THETA)
        middle = time.perf_counter()
        fbp(projector, sinogram)
        laps["odl"].append(middle - started)
        laps["ours"].append(time.perf_counter() - middle)
    return float(np.median(laps["odl"][1:])), float(np.median(laps["ours"][1:]))


def block_of_slices(slices: int = 64) -> dict[str, float]:
    """Return the milliseconds a slice from counts to the image, 360 views, and the back-projection's limit."""
    views, size = 360, 256
    projector = Projector(
        FanBeamGeometry(SCANNER, THETA, (np.arange(views) + 0.5) * TAU / views), ImageGrid(size, 400.0)
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
    rng = np.random.default_rng(views)
    mill = Mill.random(rng, views, rows=16)
    rays, start = mill.look(rng), mill.calibrated(rng)
    return median_s(lambda: detector_fit(SCANNER, rays, mill.angles_rad, start, Rotation.AS_GIVEN))


def main() -> None:
    """Print the table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="run the published search to its end (about half an hour)")
    options = parser.parse_args()
    measurement = Measurement.begin()
    name, whole = l_phantom()
    values: dict[str, Any] = {"data": name}
    for views in (360, 20):
        step = 360 // views
        sinogram, angles = whole[::step], ((np.arange(360) + 0.5) * TAU / 360)[::step]
        once, published, how = published_seconds(sinogram, full=options.full and step == 1)
        stages, limit, error = product_seconds(sinogram, angles)
        print(f"{name}, {views} x 768")
        print(f"  published pipeline (ODL, ASTRA CPU): {once:.4f} s an evaluation, {published:8.1f} s in all ({how})")
        print(f"  product: {stages['total']:.4f} s in all, ray error at most {error:.3f} mm")
        print("    " + ", ".join(f"{stage} {seconds:.4f} s" for stage, seconds in stages.items() if stage != "total"))
        print(f"  ratio: {published / stages['total']:,.0f}")
        odl_seconds, our_seconds = one_fbp(sinogram, angles)
        print(f"  one 256 x 256 FBP: ODL {odl_seconds:.4f} s, ours {our_seconds:.4f} s", end="")
        print(f", ratio {odl_seconds / our_seconds:.1f}")
        with tempfile.TemporaryDirectory() as folder:
            shell, shell_processor = from_the_shell(sinogram, Path(folder))
        print(f"  from the shell: {shell:.2f} s, {shell_processor:.2f} s of the processor")
        values[f"views_{views}"] = {
            "product_s": stages["total"],
            "published_s": published,
            "published_how": how,
            "ratio": published / stages["total"],
            "limit_s": limit,
            "ray_error_mm": error,
            "shell_s": shell,
            "shell_processor_s": shell_processor,
            "shell_ratio": published / shell,
            "odl_fbp_s": odl_seconds,
            "fbp_s": our_seconds,
            "fbp_ratio": odl_seconds / our_seconds,
        }
    values["fbp_block"], values["total_variation"] = block_of_slices(), few_views_slices()
    values["drift_check"] = {f"views_{views}_s": drift_check_s(views) for views in (20, 45, 120, 360)}
    values["start"] = {f"{name}_processor_s": started_s(f"--{name}")[1] for name in ("version", "help")}
    values["start"]["ready_s"] = ready_s()
    for name in ("fbp_block", "total_variation", "drift_check", "start"):
        print(f"{name}: {', '.join(f'{key} {value:.3g}' for key, value in values[name].items())}")
    measurement.write({"speed": values})


if __name__ == "__main__":
    main()
