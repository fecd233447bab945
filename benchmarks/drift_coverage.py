"""Do the intervals of one drift look hold? Production scans at random over the whole range that the check states.

    python benchmarks/drift_coverage.py [--logs 1000] [--seed 1] [--views 8 12 ...] [--rows 1 60 ...]
        [--encoder 0.1] [--nails none|masked|left]

Every scanner of `mill_logs` scans `BASELINE` quiet logs and one more, before which half of them drift. Each look
is compared with the calibration (absolute); the last one also with the product's baseline of those before it, whose
flat field's error has stayed. Prints for each class the share refused, bias, RMS error, median error and median
standard deviation of u_c, the RMS error of the tilt, how often 1.96 standard deviations held the truth, the RMS of
errors in standard deviations, and how many quiet looks were called moved; then the processor's time for a look.
"""

import argparse
import math
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from mill_logs import DISTANCE_ERROR_MM, Drift, Mill, Nails
from rich.progress import track
from scanners import SCANNER

from sawmill_tomography.drift.change import SIGNIFICANT, DetectorFit, DriftError
from sawmill_tomography.drift.chart.looks import FEWEST_BASELINE_LOOKS, Baseline, DriftCheckPoint
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate, Rotation

VIEWS = (8, 10, 12, 16, 20, 30, 45, 60, 90, 120, 180, 360)
ROWS = (1, 4, 16, 60, 250, 1000, 2500)
# Logs of a scanner before the one that is compared with their mean.
BASELINE = 4
# Views and rows at which the check promises 0.05 mm.
PROMISED = (20, 60)
# Least number of rows at which the sender can leave out rows with a nail, and the share of such scans.
MASKED_FROM, MASKED_SHARE = 16, 0.3


@dataclass
class Tally:
    """The looks of one class: errors and standard deviations of u_c (mm) and tau (rad), and which were quiet."""

    refused: Counter[str] = field(default_factory=Counter)
    errors: list[FloatArray] = field(default_factory=list)
    deviations: list[FloatArray] = field(default_factory=list)
    quiet: list[bool] = field(default_factory=list)

    def add(self, error: FloatArray, covariance: FloatArray, *, quiet: bool) -> None:
        """Count an answer."""
        self.errors.append(error)
        self.deviations.append(np.sqrt(np.diag(covariance)))
        self.quiet.append(quiet)

    def line(self) -> str:
        """Format the printed line of the class."""
        refused = self.refused.total()
        tried = len(self.errors) + refused
        if not self.errors:
            return f"{tried:5d} {1.0:7.1%}  {dict(self.refused)}"
        error, deviation = np.array(self.errors), np.array(self.deviations)
        share = error / deviation
        rms, spread = (np.sqrt(np.mean(each**2, axis=0)) for each in (error, share))
        held = np.mean(np.abs(share) <= 1.96, axis=0)
        moved = np.any(np.abs(share) > SIGNIFICANT, axis=1) & np.array(self.quiet)
        return (
            f"{tried:5d} {refused / tried:7.1%} {error[:, 0].mean():+8.4f} {rms[0]:7.4f} "
            f"{np.median(np.abs(error[:, 0])):7.4f} {np.median(deviation[:, 0]):7.4f} {math.degrees(rms[1]):8.4f}   "
            f"{held[0]:6.1%} {held[1]:6.1%}   {spread[0]:4.2f} {spread[1]:4.2f}   {moved.sum():3d} of {sum(self.quiet)}"
            f"  {dict(self.refused) or ''}"
        )


class Study:
    """Tallies of both comparisons by class, and the seconds that looks took by number of views."""

    def __init__(self) -> None:
        self.absolute: dict[str, Tally] = defaultdict(Tally)
        self.baseline: dict[str, Tally] = defaultdict(Tally)
        self.seconds: dict[int, list[float]] = defaultdict(list)

    def scanner(self, rng: np.random.Generator, mill: Mill, views: int, nails: Nails | None) -> None:
        """Count one scanner's looks."""
        moved = Drift(float(rng.normal(0.0, 1.0)), float(rng.normal(0.0, 0.003))) if rng.uniform() < 0.5 else None
        start = mill.calibrated(rng)
        looks: list[DriftCheckPoint] = []
        for log in range(BASELINE + 1):
            drift = moved if log == BASELINE else None
            shown: Nails = nails or ("masked" if mill.rows >= MASKED_FROM and rng.uniform() < MASKED_SHARE else "none")
            classes = _classes(mill, views, shown)
            rays = mill.look(rng, drift, nails=shown)
            started = time.process_time()
            try:
                fit = detector_fit(SCANNER, rays, mill.angles_rad, start, Rotation.AS_GIVEN)
            except DriftError as refusal:
                for name in classes:
                    self.absolute[name].refused[refusal.code] += 1
                continue
            finally:
                self.seconds[views].append(time.process_time() - started)
            truth = mill.frame(drift)
            error = np.array([fit.cor_column_mm - truth.cor_column_mm, fit.tilt_rad - truth.tilt_rad])
            for name in classes:
                self.absolute[name].add(error, _absolute(fit), quiet=drift is None)
            if log < BASELINE:
                looks.append(DriftCheckPoint(0.0, DetectorEstimate.of(error, fit.covariance[:2, :2])))
            elif len(looks) >= FEWEST_BASELINE_LOOKS:
                # The error of the calibrated SDD is in all looks alike.
                zero = Baseline.of(looks).estimate.change
                for name in classes:
                    self.baseline[name].add(
                        error - zero.values, fit.covariance[:2, :2] + zero.covariance, quiet=moved is None
                    )

    def report(self) -> None:
        """Print the tables."""
        columns = "scans refused     bias     RMS  median     s.d.  tilt deg    u_c   tilt     in s.d.   moved"
        for title, tallies in (("absolute", self.absolute), ("against a baseline", self.baseline)):
            print(f"{title:22s}{columns}")
            for name in sorted(tallies):
                print(f"{name:22s}{tallies[name].line()}")
        for views, seconds in sorted(self.seconds.items()):
            print(f"{views} views of {SCANNER.num_detector_pixels} cells: {np.median(seconds):.3f} s")


def _absolute(fit: DetectorFit) -> FloatArray:
    """Return the covariance (2, 2), with the contribution of the calibration's SDD."""
    by_distance = DISTANCE_ERROR_MM * fit.distance_sensitivity
    covariance: FloatArray = fit.covariance[:2, :2] + np.outer(by_distance, by_distance)
    return covariance


def _classes(mill: Mill, views: int, nails: Nails) -> Sequence[str]:
    noise = f"white, {mill.noise:.0%}" if mill.photons is None else f"1e{math.log10(mill.photons):.0f} photons"
    promised = ["20 views of 60 rows"] if (views, mill.rows) == PROMISED else []
    return ["all", f"{views:3d} views", f"{mill.rows:4d} rows", mill.turn, noise, f"nails {nails}", *promised]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--views", type=int, nargs="+", default=list(VIEWS))
    parser.add_argument("--rows", type=int, nargs="+", default=list(ROWS))
    parser.add_argument("--encoder", type=float, default=0.0, help="degrees that the angles are wrong by once a turn")
    parser.add_argument("--nails", choices=("none", "masked", "left"), help="in all logs; by default masked in some")
    options = parser.parse_args()
    study = Study()
    for number in track(range(options.logs // (BASELINE + 1)), description="scanners"):
        rng = np.random.default_rng([options.seed, number])
        views = options.views[number % len(options.views)]
        mill = Mill.random(rng, views, int(rng.choice(options.rows)), encoder_deg=options.encoder)
        study.scanner(rng, mill, views, options.nails)
    print(f"{options.logs} logs, seed {options.seed}, of {BASELINE + 1} each from one scanner")
    study.report()


if __name__ == "__main__":
    main()
