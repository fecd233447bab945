"""Calibrations of scanners whose object is turned between passages, so that each view has a pose of its own.

Exact chords (tests/support/exact_chords.py) of both built-in phantoms, 20 to 360 views. Shifts along and across the
beam and rolls are normal, with standard deviations of 0.1 to 2 mm and 0.05 to 0.5 degrees, log-uniform; noise is 0.2 to
0.6 % of the deepest shadow, as of 10 to 100 rows with 2 %. The ray error compares the rays of each view, with its
fitted pose, in the phantom's frame, after the best common rigid motion and scale. Prints a line for each scan, and
writes `results/passages.json`.

    python benchmarks/passages.py [--scans 300] [--first 0]
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np
from measurement import Measurement

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_vocabulary import ObjectTurns, Scanner, SourceFrame

sys.path.append(str(Path(__file__).parents[1] / "tests/support"))
from exact_chords import Detector, full_turn, scan, view_ray_error

SEED = 5104
SCANNER = Scanner(859.46, 768, 1.502864583, object_turns=ObjectTurns.BETWEEN_PASSAGES)
DETECTOR = Detector(SCANNER.num_detector_pixels, SCANNER.detector_pitch_mm)
VIEWS = (20, 30, 45, 60, 90, 180, 360)
# A scan is good where its true ray error is below half of the tolerance, mm.
TOLERANCE_MM, GOOD_MM = 0.1, 0.05
# Of scans with smaller shifts, or at least this number of views, the good ones should pass.
SMALL_MM, MANY = 0.5, 60


def measure(number: int) -> dict[str, float]:
    """Simulate and calibrate one scan."""
    rng = np.random.default_rng([SEED, number])
    views = int(rng.choice(VIEWS))
    shift_mm = math.exp(rng.uniform(math.log(0.1), math.log(2.0)))
    roll_rad = math.radians(math.exp(rng.uniform(math.log(0.05), math.log(0.5))))
    frame = SourceFrame(
        rng.uniform(0.0, 6.0),
        rng.uniform(862.0, 940.0),
        rng.uniform(1400.0, 1700.0),
        rng.uniform(-80.0, 80.0),
        rng.uniform(-0.1, 0.1),
    )
    phantom, position = (L_SHAPE, RECTANGLE_WITH_HOLE)[number % 2], rng.uniform(-10.0, 10.0, 2)
    shifts, rolls = shift_mm * rng.standard_normal((views, 2)), roll_rad * rng.standard_normal(views)
    angles = full_turn(views)
    shapes = phantom.moved(*position).of_density(0.004).shapes
    lines = -np.log(scan(shapes, DETECTOR, frame, angles, moved_mm=shifts, turned_rad=rolls))
    lines += rng.uniform(0.002, 0.006) * lines.max() * rng.standard_normal(lines.shape)
    started = time.process_time()
    found = calibrate(CalibrationTask(SCANNER, phantom, lines, angles), seed=number)
    seconds = time.process_time() - started
    return {
        "views": views,
        "shift_mm": shift_mm,
        "roll_deg": math.degrees(roll_rad),
        "error_mm": _error_mm(found, frame, position, shifts, rolls),
        "rms_mm": found.findings.error_bars.predicted_ray_error.rms_mm,
        "upper_95_mm": found.findings.error_bars.predicted_ray_error.upper_95_mm,
        "passes": found.judgement.rays_verdict == "pass",
        "column_off": abs(found.frame.cor_column_mm - frame.cor_column_mm) / _column_mm(found),
        "seconds": seconds,
    }


def _error_mm(
    found: CalibrationOutcome, frame: SourceFrame, position_mm: FloatArray, shift_mm: FloatArray, roll_rad: FloatArray
) -> float:
    """Compute the true ray error of a calibration with its views' poses."""
    assert found.view_poses is not None
    pose = found.view_poses + np.array([0.0, *(np.array(found.findings.fit.position_mm) - position_mm)])
    angles = found.rotation.apply(found.task.angles_rad)
    return view_ray_error(DETECTOR, frame, found.frame, angles, (shift_mm, roll_rad), pose, found.radius_mm)


def _column_mm(found: CalibrationOutcome) -> float:
    """Return the standard deviation of u_c, mm."""
    return math.sqrt(found.findings.error_bars.covariance.values[3, 3])


def main() -> None:
    """Print each scan, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    measurement = Measurement.begin("worker/sawmill_tomography")
    rows = []
    for number in range(options.first, options.first + options.scans):
        rows.append(row := measure(number))
        print(number, " ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
    of = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    good, held = of["error_mm"] < GOOD_MM, of["error_mm"] <= of["upper_95_mm"]
    asked = good & ((of["shift_mm"] <= SMALL_MM) | (of["views"] >= MANY))
    values = {
        "scans": len(rows),
        "wrong": int((of["passes"] * (of["error_mm"] > TOLERANCE_MM)).sum()),
        "holds_percent": 100.0 * float(held.mean()),
        "passes_percent": 100.0 * float(of["passes"].mean()),
        "of_good_percent": 100.0 * float(of["passes"][asked].mean()),
        "median_error_mm": float(np.median(of["error_mm"])),
        "median_upper_95_mm": float(np.median(of["upper_95_mm"])),
        "column_within_2_deviations_percent": 100.0 * float((of["column_off"] < 2.0).mean()),
        "median_seconds": float(np.median(of["seconds"])),
    }
    print(values)
    measurement.write({"passages": values}, timed=False)


if __name__ == "__main__":
    main()
