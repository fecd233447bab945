"""Frequency of logs that contradict a good calibration by the phantom in the same scan: simulated, no movement.

    python benchmarks/second_witness.py [--scans 200] [--seed 1] [--views 20]

Scanners, phantoms (one has a hole) and their noise are from `scanners.py`, logs from `mill_logs`, 16 rows
averaged. Prints how the two agree, verdicts without and with the log, false refusals (a pass that the log took away
although the rays are right to 0.1 mm), refusals to hear the log, and ray errors without and with it.
"""

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np
from mill_logs import Mill, holds_any_log
from rich.progress import track
from scanners import PHANTOMS, SCANNER, draw_scanner, leaves_air

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.calibration.judgement import Evidence
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.calibration.with_log import with_log
from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import GeometryError
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.projection.analytic import DetectorCells, project

ROWS, RIGHT_MM, AIR = 16, 0.1, 14
CELLS = DetectorCells.of(SCANNER)


def scan(rng: np.random.Generator, views: int) -> tuple[CalibrationTask, Mill]:
    """Simulate a phantom's noisy scan, and the scanner as it scans a log, both with air at the detector's ends."""
    while True:
        drawn = draw_scanner(rng, PHANTOMS, (views,), 20.0)
        frame = drawn.theta.source_frame(SCANNER.source_to_cor_mm)
        angles = drawn.rotation.apply(drawn.angles_rad)
        mill = Mill.random(rng, views, ROWS)
        mill = replace(mill, theta=drawn.theta, angles_rad=angles, turn="even turn")
        try:
            clean = project(drawn.seen.of_density(SAPWOOD_PER_MM), CELLS, frame, angles)
        except GeometryError:
            continue
        if leaves_air(clean, AIR) and holds_any_log(drawn.theta):
            break
    noise = mill.noise * np.sqrt(np.mean(clean**2))
    task = CalibrationTask(
        SCANNER,
        drawn.drawing,
        clean + noise * rng.standard_normal(clean.shape),
        drawn.angles_rad,
        handedness=drawn.handedness,
        rotation=drawn.rotation,
    )
    return task, mill


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, default=20)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    errors, chi_squared = [], []
    for number in track(range(options.scans), description="scans"):
        rng = np.random.default_rng([options.seed, number])
        task, mill = scan(rng, options.views)
        try:
            alone = calibrate(task, seed=number)
            heard = with_log(alone, mill.look(rng))
        except (CalibrationError, DriftError) as refusal:
            counts[f"refused: {refusal.code}"] += 1
            continue
        witness = heard.findings.witness if isinstance(heard.findings, Evidence) else None
        if witness is None:
            counts["without error bars"] += 1
            continue
        off = [ray_error(SCANNER, mill.frame(), each.frame).rms_mm for each in (alone, heard)]
        errors.append(off)
        chi_squared.append(witness.chi_squared)
        counts[f"{witness.agreement.value}, {witness.taken} taken"] += 1
        verdicts = [each.judgement.verdict for each in (alone, heard)]
        counts[f"verdict {verdicts[0]}, with the log {verdicts[1]}"] += 1
        if verdicts[0] == "pass" != verdicts[1] and off[0] < RIGHT_MM:
            counts["FALSE REFUSALS"] += 1
    print(f"{options.scans} scans of {options.views} views, seed {options.seed}")
    for name, count in sorted(counts.items()):
        print(f"  {name:40s}{count:5d}")
    print(f"  chi-squared of 2 degrees of freedom: below 5.99 in {np.mean(np.array(chi_squared) < 5.991):.1%}")
    print("  RMS ray error, mm: median without {:.4f}, with the log {:.4f}".format(*np.median(errors, axis=0)))


if __name__ == "__main__":
    main()
