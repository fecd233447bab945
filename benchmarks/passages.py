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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measurement import Measurement

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.detector_shape import cell_points
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import ObjectTurns, Scanner, SourceFrame

sys.path.append(str(Path(__file__).parents[1] / "tests/support"))
from exact_chords import Detector, full_turn, scan

SEED = 5104
SCANNER = Scanner(859.46, 768, 1.502864583, object_turns=ObjectTurns.BETWEEN_PASSAGES)
DETECTOR = Detector(SCANNER.num_detector_pixels, SCANNER.detector_pitch_mm)
VIEWS = (20, 30, 45, 60, 90, 180, 360)
# A scan is good where its true ray error is below half of the tolerance, mm.
TOLERANCE_MM, GOOD_MM = 0.1, 0.05
# Of scans with smaller shifts, or at least this number of views, the good ones should pass.
SMALL_MM, MANY = 0.5, 60


@dataclass(frozen=True, eq=False)
class Passages:
    """A scan of a phantom by passages, and the truth: position, shifts (views, 2) and rolls (views,)."""

    task: CalibrationTask
    detector: Detector
    frame: SourceFrame
    position_mm: FloatArray
    shift_mm: FloatArray
    roll_rad: FloatArray

    @classmethod
    def simulated(
        cls,
        phantom: Phantom,
        frame: SourceFrame,
        sizes: tuple[float, float],
        views: int,
        rng: np.random.Generator,
        *,
        noise: float,
        detector: Detector = DETECTOR,
    ) -> "Passages":
        """Simulate a scan with these standard deviations of shifts, mm, and rolls, rad."""
        position, angles = rng.uniform(-10.0, 10.0, 2), full_turn(views)
        shifts, rolls = sizes[0] * rng.standard_normal((views, 2)), sizes[1] * rng.standard_normal(views)
        shapes = phantom.moved(*position).of_density(0.004).shapes
        lines = -np.log(scan(shapes, detector, frame, angles, moved_mm=shifts, turned_rad=rolls))
        lines += noise * lines.max() * rng.standard_normal(lines.shape)
        return cls(CalibrationTask(SCANNER, phantom, lines, angles), detector, frame, position, shifts, rolls)

    def error_mm(self, found: CalibrationOutcome) -> float:
        """Compute the true ray error of a calibration with its views' poses."""
        assert found.view_poses is not None
        pose = found.view_poses[:, 1:] + np.array(found.findings.fit.position_mm) - self.position_mm
        true, other = (self.detector.points(self.frame, 1)[:, 0], cell_points(found.scanner, found.frame))
        ray, other = (ends / np.hypot(*ends.T)[:, None] for ends in (true, other))
        centre = np.array([0.0, self.frame.source_distance_mm])
        half = found.radius_mm**2 - (centre @ centre - (ray @ centre) ** 2)
        met = np.flatnonzero(half > 0.0)
        along = (ray @ centre)[met, None] + np.sqrt(half[met])[:, None] * np.linspace(-1.0, 1.0, 9)
        points, normal = along[..., None] * ray[met, None], np.stack([-other[:, 1], other[:, 0]], -1)[met, None]
        distances, slopes = [], []
        for view, angle in enumerate(self.task.angles_rad):
            inside = _rotated(angle + self.frame.psi_rad + self.roll_rad[view], points - centre - self.shift_mm[view])
            turn = -(angle + found.frame.psi_rad + found.view_poses[view, 0])
            seen = _rotated(turn, inside + pose[view]) + np.array([0.0, found.frame.source_distance_mm])
            distances.append((normal * seen).sum(axis=-1).ravel())
            ways = (np.array([1.0, 0.0]), np.array([0.0, 1.0]), _rotated(0.5 * math.pi, inside), inside)
            slopes.append([(normal * _rotated(turn, way) + 0.0 * inside).sum(axis=-1).ravel() for way in ways])
        off, by = np.concatenate(distances), np.concatenate(slopes, axis=1).T
        left = off - by @ np.linalg.lstsq(by, off)[0]
        return float(np.sqrt(np.mean(left**2)))


def _rotated(angle: float, points: FloatArray) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.stack([c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1]], -1)


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
    phantom = (L_SHAPE, RECTANGLE_WITH_HOLE)[number % 2]
    made = Passages.simulated(phantom, frame, (shift_mm, roll_rad), views, rng, noise=rng.uniform(0.002, 0.006))
    started = time.process_time()
    found = calibrate(made.task, seed=number)
    seconds = time.process_time() - started
    bars = found.findings.error_bars
    assert bars is not None
    u_c = FitParameter.U_C
    return {
        "views": views,
        "shift_mm": shift_mm,
        "roll_deg": math.degrees(roll_rad),
        "error_mm": made.error_mm(found),
        "upper_95_mm": bars.predicted_ray_error.upper_95_mm,
        "passes": found.judgement.rays_verdict == "pass",
        "column_off": abs(found.frame.cor_column_mm - frame.cor_column_mm) / bars.frame_deviation(found.frame)[u_c],
        "seconds": seconds,
    }


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
