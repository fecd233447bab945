"""Blind calibration of random scanners: how many end at the true rays, and is a wrong one called good.

    python benchmarks/random_scanners.py [--scans 1000] [--seed 1] [--write]
        [--method multi-start|differential-evolution]

A scan counts as calibrated within 0.1 mm RMS ray error, handedness and sense of rotation included. Wrong and reported
as `pass` is the worst outcome and is counted by itself. `--write` writes `benchmarks/results/random-scanners.json`.
"""

import argparse
import time
from collections import Counter

import numpy as np
from evolution import calibrate_by_evolution
from measurement import Measurement
from rich.progress import track
from scanners import SCANNER, random_scan

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.geometry.ray_error import ray_error

LIMIT_MM = 0.1


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--method", choices=("multi-start", "differential-evolution"), default="multi-start")
    way.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args()
    measurement = Measurement.begin("worker/sawmill_tomography/calibration") if options.write else None
    solve = calibrate if options.method == "multi-start" else calibrate_by_evolution
    rng = np.random.default_rng(options.seed)
    outcomes: Counter[str] = Counter()
    errors, seconds = [], []
    for number in track(range(options.scans), description=options.method):
        scan = random_scan(rng)
        started = time.perf_counter()
        try:
            found = solve(scan.task, seed=number)
        except CalibrationError as error:
            outcomes[f"refused: {error.code}"] += 1
            print(f"scan {number}: {error.code}: {error}")
            continue
        seconds.append(time.perf_counter() - started)
        error = ray_error(SCANNER, scan.frame, found.frame, other_scanner=found.scanner).rms_mm
        errors.append(error)
        right = error < LIMIT_MM and (found.handedness, found.rotation) == (scan.handedness, scan.rotation)
        outcomes[f"{'right' if right else 'WRONG'}, verdict {found.judgement.verdict}"] += 1
        if not right:
            print(f"scan {number}: off by {error:.3f} mm, {found.judgement}; truth {scan.theta}")
    print(f"{options.method}: {options.scans} random scanners, seed {options.seed}")
    for outcome, count in sorted(outcomes.items()):
        print(f"  {outcome:32s} {count:5d}  {count / options.scans:7.2%}")
    print("  ray error, mm: median {:.4f}, 95 % {:.4f}, largest {:.4f}".format(*np.quantile(errors, [0.5, 0.95, 1.0])))
    print("  seconds: median {:.3f}, 95 % {:.3f}, largest {:.3f}".format(*np.quantile(seconds, [0.5, 0.95, 1.0])))
    if measurement is not None:
        values = {
            "scans": options.scans,
            "right": sum(count for outcome, count in outcomes.items() if outcome.startswith("right")),
            "right_and_passed": outcomes["right, verdict pass"],
            "median_error_mm": float(np.median(errors)),
            "largest_error_mm": max(errors),
        }
        measurement.write({"random-scanners": values}, timed=False)


if __name__ == "__main__":
    main()
