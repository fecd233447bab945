"""Do the intervals of one drift look hold? Production scans at random over the whole stated range.

    python benchmarks/drift_coverage.py [--logs 1000] [--seed 1] [--views 8 12 ...] [--rows 1 10 ...]

Each scanner scans logs of `mill_logs`, quiet ones and then a drifted one. Looks are compared with the calibration
(absolute) and with the mean of the first looks of the same scanner (baseline), whose flat field's error has stayed.
"""

import argparse
import math
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace

import numpy as np
from mill_logs import Drift, Mill
from scanners import SCANNER

from sawmill_worker.tomography.detector_fit import detector_fit
from sawmill_worker.tomography.drift import SIGNIFICANT, DriftError
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.vocabulary import Rotation

VIEWS = (8, 10, 12, 16, 20, 30, 45, 60, 90, 120, 180, 360)
ROWS = (1, 4, 16, 60, 250, 1000, 2500)
BASELINE = 4
# The calibration's own error of SDD, mm.
DISTANCE_ERROR_MM = 0.5


@dataclass
class Tally:
    refused: Counter[str] = field(default_factory=Counter)
    errors: list[FloatArray] = field(default_factory=list)
    spreads: list[FloatArray] = field(default_factory=list)
    alarms: list[bool] = field(default_factory=list)

    def add(self, error: FloatArray, covariance: FloatArray, quiet: bool) -> None:
        self.errors.append(error)
        self.spreads.append(np.sqrt(np.diag(covariance)))
        if quiet:
            self.alarms.append(bool(np.any(np.abs(error) > SIGNIFICANT * self.spreads[-1])))

    def line(self) -> str:
        tried = len(self.errors) + self.refused.total()
        if not self.errors:
            return f"{tried:5d} {self.refused.total() / tried:6.1%} {dict(self.refused)}"
        e, s = np.array(self.errors), np.array(self.spreads)
        z = e / s
        inside = np.mean(np.abs(z) < 1.96, axis=0)
        return (
            f"{tried:5d} {self.refused.total() / max(tried, 1):6.1%}  {np.mean(e[:, 0]):+8.4f} {math.sqrt(np.mean(e[:, 0] ** 2)):7.4f} "
            f"({np.median(np.abs(e[:, 0])):.4f}) {np.median(s[:, 0]):7.4f}  {math.degrees(math.sqrt(np.mean(e[:, 1] ** 2))):7.4f}  "
            f"{inside[0]:6.1%} {inside[1]:6.1%}  z {np.sqrt(np.mean(z**2, axis=0)).round(2)} {np.sqrt(np.median(z**2, axis=0)/0.4549).round(2)} "
            f"{sum(self.alarms):3d}/{len(self.alarms)} {dict(self.refused) or ''}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, nargs="+", default=list(VIEWS))
    parser.add_argument("--rows", type=int, nargs="+", default=list(ROWS))
    parser.add_argument("--encoder", type=float, default=0.0)
    parser.add_argument("--nails", default=None)
    parser.add_argument("--deviations", action="store_true")
    options = parser.parse_args()
    tallies = {"absolute": defaultdict(Tally), "baseline": defaultdict(Tally)}
    seconds = defaultdict(list)
    for number in range(options.logs // (BASELINE + 1)):
        rng = np.random.default_rng([options.seed, number])
        views, rows = options.views[number % len(options.views)], int(rng.choice(options.rows))
        mill = Mill.random(rng, views, rows, encoder_deg=options.encoder)
        drift = Drift(float(rng.normal(0.0, 1.0)), float(rng.normal(0.0, 0.003))) if rng.uniform() < 0.5 else None
        distance = rng.normal(0.0, DISTANCE_ERROR_MM)
        before = mill.frame()
        start = replace(before, source_to_detector_mm=before.source_to_detector_mm + distance)
        looks = []
        for log in range(BASELINE + 1):
            moved = drift if log == BASELINE else None
            nails = options.nails or (str(rng.choice(["none", "masked"], p=[0.7, 0.3])) if rows >= 16 else "none")
            rays, deviations = mill.look(rng, moved, nails=nails)
            tags = ["all", f"{views:3d} views", f"{rows:4d} rows", mill.turn, "white" if mill.photons is None else "counts",
                    f"nails {nails}", f"noise {mill.noise // 0.01 / 100}" if mill.photons is None else f"log10 photons {math.log10(mill.photons) // 0.5 * 0.5}"]
            if (views, rows) == (20, 60): tags.append("20 views of 60 rows")
            t = time.perf_counter()
            try:
                fit = detector_fit(SCANNER, rays, mill.angles_rad, start, Rotation.AS_GIVEN, deviations=deviations if options.deviations else None)
            except DriftError as refusal:
                for tag in tags:
                    tallies["absolute"][tag].refused[refusal.code] += 1
                continue
            seconds[views].append(time.perf_counter() - t)
            truth = mill.frame(moved)
            error = np.array([fit.cor_column_mm - truth.cor_column_mm, fit.tilt_rad - truth.tilt_rad])
            cov = fit.covariance[:2, :2] + DISTANCE_ERROR_MM**2 * np.outer(fit.distance_sensitivity, fit.distance_sensitivity)
            if fit.rotation is not Rotation.AS_GIVEN: print("WRONG SENSE", number, log, tags)
            for tag in tags:
                tallies["absolute"][tag].add(error, cov, moved is None)
            looks.append((log, error, fit.covariance[:2, :2]))
            if abs(error[0]) > 4 * math.sqrt(cov[0, 0]): print(number, log, error, np.sqrt(np.diag(cov)), tags, drift)
        if looks and looks[-1][0] == BASELINE and len(looks) > 1:
            base = looks[:-1]
            error = looks[-1][1] - np.mean([e for _, e, _ in base], axis=0)
            cov = looks[-1][2] + np.sum([c for *_, c in base], axis=0) / len(base) ** 2
            for tag in tags:
                tallies["baseline"][tag].add(error, cov, drift is None)
    for kind, groups in tallies.items():
        print(kind)
        for tag in sorted(groups):
            print(f"{tag:22s}{groups[tag].line()}")
    print({views: round(float(np.median(each)), 3) for views, each in sorted(seconds.items())})


if __name__ == "__main__":
    main()
