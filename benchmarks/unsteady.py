"""Phantoms that slip during scans in counts: how many are named, and what passes although its rays are off.

    python benchmarks/unsteady.py [--scans 31] [--seed 1]

Random scanners and phantoms, 20 to 360 views, 5 000 to 50 000 photons, ten flats. Each scan is prepared with and
without ring removal; it is steady, or slips by 0.3 to 0.7 mm, alone or with one more fault. The table shows the median
and the largest true ray error, the median of its predicted 95 % bound, how often the bound held, the verdicts, the
scans in which a slip was named, and those that passed with an error above the tolerance.
"""

import argparse
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from counted import FAULTS, VIEWS, CountedScan, Fault, Slip, counted_scan
from rich.progress import track
from scanners import SCANNER

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.geometry.ray_error import ray_error

TOLERANCE_MM = 0.1
UNSTEADY = ("The phantom moved at view", "The angles jump", "The turntable turns", "The angles are ahead")


def steady(rng: np.random.Generator, views: tuple[int, ...] = VIEWS) -> CountedScan:
    """Simulate a scan without any fault."""
    return counted_scan(rng, views=views)


def with_a_fault(rng: np.random.Generator, views: tuple[int, ...] = VIEWS) -> CountedScan:
    """Simulate a steady scan with another fault."""
    return counted_scan(rng, fault=_any_fault(rng), views=views)


def slipped(rng: np.random.Generator, views: tuple[int, ...] = VIEWS) -> CountedScan:
    """Simulate a scan with a slip alone."""
    return counted_scan(rng, slip=Slip.random(rng), views=views)


def slipped_with_a_fault(rng: np.random.Generator, views: tuple[int, ...] = VIEWS) -> CountedScan:
    """Simulate a scan with a slip and another fault."""
    return counted_scan(rng, slip=Slip.random(rng), fault=_any_fault(rng), views=views)


def _any_fault(rng: np.random.Generator) -> Fault:
    return list(FAULTS.values())[rng.integers(len(FAULTS))]


KINDS = {made.__name__: made for made in (steady, with_a_fault, slipped, slipped_with_a_fault)}


@dataclass
class Outcomes:
    """The results of the scans of one kind."""

    errors: list[float] = field(default_factory=list)
    bounds: list[float] = field(default_factory=list)
    verdicts: Counter[str] = field(default_factory=Counter)
    slips: list[bool] = field(default_factory=list)
    unsteady: int = 0
    wrong: int = 0

    def add(self, scan: CountedScan, found: CalibrationOutcome) -> None:
        """Record one answer."""
        assert found.findings.error_bars is not None
        error = ray_error(SCANNER, scan.frame, found.frame, other_scanner=found.scanner).rms_mm
        self.errors.append(error)
        self.bounds.append(found.findings.error_bars.predicted_ray_error.upper_95_mm)
        self.verdicts[found.judgement.verdict] += 1
        self.slips.append(any(reason.startswith(UNSTEADY[0]) for reason in found.judgement.reasons))
        self.unsteady += any(reason.startswith(UNSTEADY) for reason in found.judgement.reasons)
        self.wrong += found.judgement.verdict == "pass" and error > TOLERANCE_MM

    def row(self, name: str) -> str:
        """Format one line of the table."""
        errors, bounds = np.array(self.errors), np.array(self.bounds)
        return (
            f"{name:32s} {np.median(errors):6.3f} {errors.max():7.3f} {np.median(bounds):6.3f} "
            f"{np.mean(errors <= bounds):5.0%} {self.verdicts['pass']:5d} {self.verdicts['watch']:5d} "
            f"{self.verdicts['fail']:5d} {sum(self.slips):5d} {self.unsteady:8d} {self.wrong:7d}"
        )


def study(scans: int, seed: int) -> dict[tuple[str, bool], Outcomes]:
    """Collect the outcomes by kind, with and without ring removal."""
    outcomes = {(kind, rings): Outcomes() for kind in KINDS for rings in (False, True)}
    for kind, make in KINDS.items():
        for number in track(range(scans), description=kind):
            scan = make(np.random.default_rng([seed, number]))
            for rings in (False, True):
                outcomes[kind, rings].add(scan, calibrate(scan.task(remove_rings=rings)))
    return outcomes


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=31)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"{options.scans} scans each, seed {options.seed}")
    print(
        f"{'':32s} {'error':>6s} {'largest':>7s} {'bound':>6s} {'holds':>5s} {'pass':>5s} {'watch':>5s} {'fail':>5s} "
        f"{'slips':>5s} {'unsteady':>8s} {'wrongly':>7s}"
    )
    for (kind, rings), outcome in study(options.scans, options.seed).items():
        print(outcome.row(f"{kind.replace('_', ' ')}{', rings removed' if rings else ''}"))


if __name__ == "__main__":
    main()
