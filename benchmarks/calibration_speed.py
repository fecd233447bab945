"""Processor seconds of a calibration next to the published pipeline's, in turns on one thread, and its ray errors.

    python benchmarks/calibration_speed.py

Writes `benchmarks/results/calibration-speed.json`. The scan is `published_pipeline.claimed_scan`. A time is the least
of several laps of the processor, on one thread, which other work on the machine changes little; the ratio is that of
two times of one run. The product's time runs from the sinogram in memory to the complete answer with its uncertainty,
warm; and from the shell, start and file included. Its limit is what the multiply-adds of the joint fit's inner
products, which cannot be left out, take at the rate of a matrix product. The published search is not run to its end:
the time of one evaluation is multiplied by the evaluations that such a search took when it was run (4 389 with 360
views, 3 498 with 20). Ray errors are the worst of five seeds: up to one rotation and one scale, and up to one rotation.
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
from measurement import Measurement
from published_pipeline import PublishedObjective, claimed_scan
from scanners import SCANNER
from scans import ANGLES, TRUE_FRAME, TRUE_THETA, rotated_ray_error_mm, sources

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.joint_fit.scan_model import Term
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE

MEASURED_EVALUATIONS = {360: 4389, 20: 3498}
SEEDS = range(5)
SHELL_LAPS, MATRIX_LAPS, MATRIX_SIZE = 4, 5, 2048
ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def processor_s(run: Callable[[], object]) -> float:
    """Return the processor seconds of this process in a call."""
    started = time.process_time()
    run()
    return time.process_time() - started


def limit_s(views: int, rounds: float) -> float:
    """Return the seconds of the joint fit's inner products.

    Each round multiplies every two derivatives of the model, and each with the residual.
    """
    matrix = np.random.default_rng(1).standard_normal((MATRIX_SIZE, MATRIX_SIZE))
    multiply_add_s = min(processor_s(lambda: matrix @ matrix) for _ in range(MATRIX_LAPS)) / MATRIX_SIZE**3
    return rounds * views * SCANNER.num_detector_pixels * len(Term) * (len(Term) + 3) / 2 * multiply_add_s


def from_the_shell_s(sinogram: FloatArray) -> float:
    """Return the least processor seconds of `sawmill calibrate` as a process, start and file included."""
    step_deg = 360 // len(sinogram)
    options = ["--data", "line-integrals", "--angles-deg", f"0.5:{step_deg}", "--phantom", "l-shape", "--json"]
    options += ["--source-to-cor-mm", str(SCANNER.source_to_cor_mm)]
    options += ["--detector-pitch-mm", str(SCANNER.detector_pitch_mm)]
    laps = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.npy"
        np.save(path, sinogram)
        command = [str(Path(sys.executable).parent / "sawmill"), "calibrate", str(path), *options]
        for _ in range(SHELL_LAPS):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - our own command
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            laps.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(laps)


def compared(sinogram: FloatArray, angles: FloatArray) -> dict[str, Any]:
    """Measure the product and the published pipeline in turns, and the product's errors."""
    objective, vector = PublishedObjective(SCANNER, L_SHAPE, sinogram), to_vector(TRUE_THETA)
    runs: list[CalibrationOutcome] = []
    evaluations_s, laps_s = [], []
    for seed in SEEDS:
        evaluations_s.append(processor_s(lambda: objective(vector)))
        started = time.process_time()
        runs.append(calibrate(CalibrationTask(SCANNER, L_SHAPE, sinogram, angles), seed=seed))
        laps_s.append(time.process_time() - started)
    evaluations = MEASURED_EVALUATIONS[len(sinogram)]
    published_s = min(evaluations_s) * evaluations
    errors = [ray_error(SCANNER, TRUE_FRAME, run.frame, other_scanner=run.scanner) for run in runs]
    return {
        "processor_s": min(laps_s),
        "shell_processor_s": from_the_shell_s(sinogram),
        "published_processor_s": published_s,
        "published_how": f"{evaluations} evaluations, not run",
        "ratio": published_s / min(laps_s),
        "limit_processor_s": limit_s(len(sinogram), float(np.median([run.findings.fit.iterations for run in runs]))),
        "passed": sum(run.judgement.verdict == "pass" for run in runs),
        "seeds": len(runs),
        "error_mm": max(error.rms_mm for error in errors),
        "median_error_mm": float(np.median([error.rms_mm for error in errors])),
        "scale_error_percent": max((100.0 * error.scale_change for error in errors), key=abs),
        "error_with_scale_mm": max(rotated_ray_error_mm(run.frame, run.scanner) for run in runs),
        "corrections": len(runs[0].adjustments),
    }


def main() -> None:
    """Print the figures and write them."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    if not ONE_THREAD.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)  # noqa: S606 - this script
    measurement = Measurement.begin("worker/sawmill_tomography/calibration", "worker/sawmill_tomography/projection")
    values: dict[str, Any] = {"source": sources()[0]}
    for views in MEASURED_EVALUATIONS:
        step = ANGLES.size // views
        values[f"views_{views}"] = compared(claimed_scan()[::step], ANGLES[::step])
        print(f"{values['source']} L-phantom, {views} views:")
        print("".join(f"  {key}: {value}\n" for key, value in values[f"views_{views}"].items()))
    measurement.write({"calibration-speed": values}, timed=False)


if __name__ == "__main__":
    main()
