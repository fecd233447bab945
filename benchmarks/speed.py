"""The published pipeline and the product's calibration on the same L-phantom data, one after the other in one process.

    python benchmarks/speed.py [--full]

Writes `benchmarks/results/speed.json`.

Without --full the published search is not run to its end: the time of one evaluation is measured and multiplied by the
evaluations that such a search took when it was run (4 389 with 360 views, 3 498 with 20). The product's time is
`timing_s.total`, from the sinogram in memory to the complete answer with its uncertainty, warm; and from the shell.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measurement import Measurement
from published_pipeline import PublishedObjective, search
from scanners import SCANNER
from scipy.io import loadmat

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import DetectorCells
from sawmill_worker.tomography.built_in import L_SHAPE
from sawmill_worker.tomography.calibration.calibrate import calibrate
from sawmill_worker.tomography.calibration.task import CalibrationTask
from sawmill_worker.tomography.fbp import fbp
from sawmill_worker.tomography.geometry import TAU, FanBeamGeometry, FloatArray, Theta, to_vector
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.tomography.ray_error import ray_error

THETA = Theta(2.55023549, 714.683839, 319.943788, 43.6514375, 0.280799451)
MEASURED_EVALUATIONS = {360: 4389, 20: 3498}
REPEATS = 15


def published_file() -> Path:
    """Where the published L-phantom lies, if it does."""
    return Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "l-phantom" / "sinogram.mat"


def l_phantom() -> tuple[str, FloatArray]:
    """The published sinogram (360, 768), or a simulated one of the same scanner where it is absent."""
    path = published_file()
    if path.is_file():
        return "published L-phantom", loadmat(path)["arr"].astype(np.float64)
    frame = THETA.source_frame(SCANNER.source_to_cor_mm)
    angles = (np.arange(360) + 0.5) * TAU / 360
    return "simulated L-phantom", analytic.project(L_SHAPE, DetectorCells.of(SCANNER), frame, angles, rays_per_cell=1)


def published_seconds(sinogram: FloatArray, *, full: bool) -> tuple[float, float, str]:
    """Seconds of one evaluation, of the whole search, and how the latter is known."""
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


def product_seconds(sinogram: FloatArray, angles: FloatArray) -> tuple[dict[str, float], float]:
    """Median seconds of each stage, and the ray error."""
    calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles))
    runs = [calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles), seed=seed) for seed in range(REPEATS)]
    stages = {name: float(np.median([getattr(run.timing, name) for run in runs])) for name in vars(runs[0].timing)}
    true = THETA.source_frame(SCANNER.source_to_cor_mm)
    return stages, max(ray_error(SCANNER, true, run.frame).rms_mm for run in runs)


def from_the_shell(sinogram: FloatArray, folder: Path) -> float:
    """Measure the median seconds of `sawmill calibrate` as a process, start and file included."""
    path = folder / f"{len(sinogram)}.npy"
    np.save(path, sinogram)
    step_deg = 360 // len(sinogram)
    command = [str(Path(sys.executable).parent / "sawmill"), "calibrate", str(path), "--data", "line-integrals"]
    command += ["--angles-deg", f"0.5:{step_deg}", "--source-to-cor-mm", str(SCANNER.source_to_cor_mm)]
    command += ["--detector-pitch-mm", str(SCANNER.detector_pitch_mm), "--phantom", "l-shape", "--json"]
    laps = []
    for _ in range(4):
        started = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
        laps.append(time.perf_counter() - started)
    return float(np.median(laps[1:]))


def one_fbp(sinogram: FloatArray, angles: FloatArray) -> tuple[float, float]:
    """Median seconds of one 256 x 256 FBP: ODL's evaluation less its correlation, and ours."""
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
        stages, error = product_seconds(sinogram, angles)
        print(f"{name}, {views} x 768")
        print(f"  published pipeline (ODL, ASTRA CPU): {once:.4f} s an evaluation, {published:8.1f} s in all ({how})")
        print(f"  product: {stages['total']:.4f} s in all, ray error at most {error:.3f} mm")
        print("    " + ", ".join(f"{stage} {seconds:.4f} s" for stage, seconds in stages.items() if stage != "total"))
        print(f"  ratio: {published / stages['total']:,.0f}")
        odl_seconds, our_seconds = one_fbp(sinogram, angles)
        print(f"  one 256 x 256 FBP: ODL {odl_seconds:.4f} s, ours {our_seconds:.4f} s", end="")
        print(f", ratio {odl_seconds / our_seconds:.1f}")
        with tempfile.TemporaryDirectory() as folder:
            shell = from_the_shell(sinogram, Path(folder))
        print(f"  from the shell: {shell:.2f} s")
        values[f"views_{views}"] = {
            "product_s": stages["total"],
            "published_s": published,
            "published_how": how,
            "ratio": published / stages["total"],
            "ray_error_mm": error,
            "shell_s": shell,
            "shell_ratio": published / shell,
            "fbp_ratio": odl_seconds / our_seconds,
        }
    measurement.write({"speed": values})


if __name__ == "__main__":
    main()
