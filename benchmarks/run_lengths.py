"""Run lengths of the drift chart: false alarms a year, and the looks until a jump or a trend is found.

    python benchmarks/production_logs.py --logs 375
    python benchmarks/run_lengths.py [--errors FILE] [--scanners 200] [--days 36] [--batches 2] [--baselines 400000]

Each simulated scanner draws its looks' errors and covariances from one scanner of `production_logs`, 2 000 a day:
that scanner's covariances, errors of the size that it has by them, and the shape of the errors of all. Beyond the
97 % quantile the errors are drawn from a Pareto tail with Hill's exponent. False alarms are counted with the looks'
errors alone, without what the chart allows other logs to do; intervals are Poisson's of 95 %. Those that end a baseline
are counted in many more baselines, since a scanner that is calibrated each week has 52 a year.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from production_logs import OUT
from rich.progress import track
from scipy.special import gammaincinv

from sawmill_tomography.drift.chart.chart import (
    GROUP_LOOKS,
    LIMIT,
    QUIET,
    ChartFinding,
    DriftChart,
    DriftKind,
    Group,
    History,
)
from sawmill_tomography.drift.chart.looks import (
    BASELINE_LOOKS,
    DriftCheckPoint,
    LookSpread,
    inverse,
    pooled_means,
    scaled,
)
from sawmill_tomography.drift.chart.segments import Segment
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DetectorEstimate

LOOKS_A_DAY, DAYS_A_YEAR = 2000, 365.0
BASELINE_DAYS = BASELINE_LOOKS / LOOKS_A_DAY
LIMITS = np.arange(22.0, 41.0, 2.0)
TAIL = 0.97
# A scanner's covariances that are drawn from, and the distance of an error beyond which it says no more of the spread.
LOOKS_OF_EACH, MOST_OF_SPREAD = 20, 4.0
AT_A_TIME, BASELINES_AT_A_TIME = 50, 2000
# Jumps among the looks of the baseline come after the first and before the last of this number.
FIRST_LOOKS = 8
JUMPS_MM, TREND_MM_A_DAY = (0.02, 0.05, 0.1, 0.2), 0.01
# Days of quiet before a change, and after it until it counts as not found.
QUIET_DAYS, LONGEST_DAYS = 1.0, 6.0


@dataclass(frozen=True, eq=False)
class Errors:
    """Standardised errors of looks.

    Attributes
    ----------
    shape : (looks, 2) float64
        Errors of all scanners, whitened to unit covariance in each scanner.
    roots : (scanners, looks, 2, 2) float64
        Square roots of the covariances.
    scatter : (scanners, 2, 2) float64
        Lower Cholesky factors of the scatter of a scanner's whitened errors.
    from_radius, exponent : float
        The tail.
    """

    shape: FloatArray
    roots: FloatArray
    scatter: FloatArray
    from_radius: float
    exponent: float

    @property
    def of_fifty(self) -> FloatArray:
        """Standard deviations of u_c, (scanners,) in mm, of fifty looks pooled, as they scatter."""
        own = inverse(self.roots @ np.swapaxes(self.roots, -1, -2)).mean(axis=1) * 50.0
        scattering = self.scatter @ np.swapaxes(self.scatter, -1, -2)
        deviation: FloatArray = np.sqrt(scaled(inverse(own), scattering)[:, 0, 0])
        return deviation

    @classmethod
    def read(cls, path: Path) -> "Errors":
        """Read errors, relative to each scanner's mean, which does not change."""
        table = np.load(path)
        shapes, roots, scatters = [], [], []
        for mill in np.unique(table["mill"]):
            at = table["mill"] == mill
            errors, covariances = table["error"][at], table["covariance"][at]
            number = len(errors)
            root = np.linalg.cholesky(covariances)
            rest = errors - pooled_means(errors, covariances).mean
            white = np.linalg.solve(root, rest[..., None])[..., 0] * math.sqrt(number / (number - 1))
            # Errors bounded for a scanner's spread; outliers belong to the shape.
            bounded = white * np.minimum(1.0, MOST_OF_SPREAD / np.linalg.norm(white, axis=1))[:, None]
            scatter = np.linalg.cholesky(bounded.T @ bounded / number)
            shapes.append(np.linalg.solve(scatter, white.T).T)
            roots.append(root[np.resize(np.arange(number), LOOKS_OF_EACH)])
            scatters.append(scatter)
        shape = np.concatenate(shapes)
        radius = np.linalg.norm(shape, axis=1)
        begins = float(np.quantile(radius, TAIL))
        exponent = 1.0 / float(np.mean(np.log(radius[radius > begins] / begins)))
        return cls(shape, np.stack(roots), np.stack(scatters), begins, exponent)

    def drawn(self, rng: np.random.Generator, scanner: NDArray[np.intp], looks: int) -> tuple[FloatArray, FloatArray]:
        """Draw errors (scanners, looks, 2) with their covariances (scanners, looks, 2, 2)."""
        size = (len(scanner), looks)
        white = self.shape[rng.integers(len(self.shape), size=size)]
        radius = np.linalg.norm(white, axis=-1)
        tail = self.from_radius * rng.uniform(size=size) ** (-1.0 / self.exponent)
        white *= np.where(radius > self.from_radius, tail / radius, 1.0)[..., None]
        root = self.roots[scanner[:, None], rng.integers(self.roots.shape[1], size=size)]
        errors = np.einsum("...ij,...j->...i", root @ self.scatter[scanner, None], white)
        return errors, root @ np.swapaxes(root, -1, -2)


@dataclass(frozen=True, eq=False)
class Change:
    """A change of u_c.

    Attributes
    ----------
    name : str
    kind : DriftKind
    size : float
        Size in mm, or in mm a day.
    at : (scanners,) float64
        Times in days since the calibration.
    """

    name: str
    kind: DriftKind
    size: float
    at: FloatArray

    def of(self, days: FloatArray) -> FloatArray:
        """Compute the change, mm, (scanners, looks), at days (looks,)."""
        since = days - self.at[:, None]
        moved: FloatArray = self.size * np.where(self.kind is DriftKind.JUMP, since > 0.0, np.maximum(since, 0.0))
        return moved


@dataclass(frozen=True, eq=False)
class Simulated:
    """Scanners after a group more: the number of their looks, their history, and the group's looks."""

    number: int
    history: History
    days: FloatArray
    looks: tuple[FloatArray, FloatArray]

    def finding(self, scanner: int) -> ChartFinding:
        """Compute the chart's finding for one scanner."""
        segments = (
            Segment(
                each.groups,
                each.first_days[scanner],
                each.last_days[scanner],
                each.precision[scanner],
                each.weighted[scanner],
            )
            for each in self.history.segments
        )
        all_ = self.history.scatter
        scatter = LookSpread(all_.differences, all_.squares[scanner], all_.mean[scanner], all_.covariance[scanner])
        newest = (
            DriftCheckPoint(float(days), DetectorEstimate.of(*look))
            for days, *look in zip(self.days, *(values[scanner] for values in self.looks), strict=True)
        )
        return DriftChart(history=History(tuple(segments), scatter), newest=tuple(newest)).finding()


def simulated(
    errors: Errors, scanner: NDArray[np.intp], days: float, rng: np.random.Generator, change: Change | None = None
) -> Iterator[Simulated]:
    """Simulate each scanner for that number of days: yield it with a complete baseline and after each later group."""
    history, in_all = None, round(days * LOOKS_A_DAY / GROUP_LOOKS) * GROUP_LOOKS
    for first in range(0, in_all, AT_A_TIME * GROUP_LOOKS):
        looks = min(AT_A_TIME * GROUP_LOOKS, in_all - first)
        drawn, covariances = errors.drawn(rng, scanner, looks)
        times = (first + 1.0 + np.arange(looks)) / LOOKS_A_DAY
        if change is not None:
            drawn[..., 0] += change.of(times)
        apart = (len(scanner), looks // GROUP_LOOKS, GROUP_LOOKS)
        by_group, their_own = drawn.reshape(*apart, 2), covariances.reshape(*apart, 2, 2)
        means, by_ten = pooled_means(by_group, their_own), times.reshape(-1, GROUP_LOOKS)
        spread = inverse(means.precision)
        pooled: list[Group] = [
            (np.full(len(scanner), by_ten[k][-1]), means.mean[:, k], spread[:, k]) for k in range(apart[1])
        ]
        done = 0
        if history is None:
            done = BASELINE_LOOKS // GROUP_LOOKS
            scatter = LookSpread.of_looks(drawn[:, :BASELINE_LOOKS], covariances[:, :BASELINE_LOOKS])
            history = History.starting_with(pooled[:done], scatter)
            yield Simulated(BASELINE_LOOKS, history, by_ten[done - 1], (by_group[:, done - 1], their_own[:, done - 1]))
        for k in range(done, apart[1]):
            history = history.followed_by(*pooled[k])
            number = first + (k + 1) * GROUP_LOOKS
            yield Simulated(number, history, by_ten[k], (by_group[:, k], their_own[:, k]))


def evidence_of(history: History) -> FloatArray:
    """Return the largest evidence (2, scanners): by the looks' errors alone, and with the effects of other logs."""
    models = history.alternatives(QUIET)
    alone = np.max([history.scatter.chi_squared(model.likelihood).max(axis=0) for model in models], axis=0)
    return np.stack([alone, np.max([model.evidence.max(axis=0) for model in models], axis=0)])


def false_alarms(errors: Errors, scanners: int, days: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Count first alarms (2, limits), without and with other logs' effects, and the scanner years until the alarms."""
    scanner = rng.integers(len(errors.scatter), size=scanners)
    alarms, looks = np.zeros((2, len(LIMITS))), np.zeros((2, len(LIMITS)))
    largest = np.zeros((2, scanners))
    groups = round(days * LOOKS_A_DAY - BASELINE_LOOKS) // GROUP_LOOKS + 1
    for now in track(simulated(errors, scanner, days, rng), total=groups):
        before, largest = largest, np.maximum(largest, evidence_of(now.history))
        waiting = before[:, None] <= LIMITS[:, None]
        looks += waiting.sum(axis=2) * (BASELINE_LOOKS if now.number == BASELINE_LOOKS else GROUP_LOOKS)
        alarms += (waiting & (largest[:, None] > LIMITS[:, None])).sum(axis=2)
    return alarms, looks / LOOKS_A_DAY / DAYS_A_YEAR


def alarms_of_baselines(errors: Errors, baselines: int, rng: np.random.Generator) -> FloatArray:
    """Count baselines (2, limits) in which a jump is found though there is none, like `false_alarms`."""
    alarms = np.zeros((2, len(LIMITS)))
    for first in track(range(0, baselines, BASELINES_AT_A_TIME)):
        number = min(BASELINES_AT_A_TIME, baselines - first)
        complete = next(simulated(errors, rng.integers(len(errors.scatter), size=number), BASELINE_DAYS, rng))
        alarms += (evidence_of(complete.history)[:, None] > LIMITS[:, None]).sum(axis=2)
    return alarms


@dataclass(frozen=True)
class Found:
    """The alarm on one change: the scanner, the looks until the alarm, and the finding."""

    scanner: int
    looks: int
    finding: ChartFinding


def found(errors: Errors, change: Change, rng: np.random.Generator) -> tuple[list[Found], int]:
    """Collect the findings at the alarms, and the number of false alarms before the change."""
    scanners = len(change.at)
    waiting, early, findings = np.ones(scanners, bool), 0, []
    scanner, days = np.arange(scanners) % len(errors.scatter), change.at.max() + LONGEST_DAYS
    for now in simulated(errors, scanner, days, rng, change):
        for at in np.flatnonzero(waiting & (evidence_of(now.history)[1] > LIMIT)).tolist():
            after = now.number - math.floor(change.at[at] * LOOKS_A_DAY)
            waiting[at] = False
            if after <= 0:
                early += 1
            else:
                findings.append(Found(at, after, now.finding(at)))
        if not waiting.any():
            break
    return findings, early


def changes(scanners: int) -> Iterator[Change]:
    """Yield jumps after each number of looks in a group of ten, in turn, and among the first fifty; a trend."""
    turn = np.arange(scanners) % GROUP_LOOKS + 0.5
    for size in JUMPS_MM:
        at = QUIET_DAYS + turn / LOOKS_A_DAY
        yield Change(f"jump {size:4.2f} mm", DriftKind.JUMP, size, at)
    for size in JUMPS_MM:
        at = (np.linspace(FIRST_LOOKS, BASELINE_LOOKS - FIRST_LOOKS, scanners).round() + 0.5) / LOOKS_A_DAY
        yield Change(f"among the first 50, {size:4.2f} mm", DriftKind.JUMP, size, at)
    yield Change("trend 0.01 mm a day", DriftKind.TREND, TREND_MM_A_DAY, np.full(scanners, QUIET_DAYS))


def print_delays(errors: Errors, scanners: int, rng: np.random.Generator) -> None:
    """Print one line a change."""
    print(f"\nlooks from a change of u_c to its alarm; {scanners} scanners, limit {LIMIT}")
    print(f"{'change':28s}  found  median  90 %   right kind  time in interval  size within 1.96 s.d.  median share")
    for change in changes(scanners):
        findings, early = found(errors, change, rng)
        looks = np.full(scanners - early, math.inf)
        looks[: len(findings)] = [each.looks for each in findings]
        right = [each for each in findings if each.finding.kind is change.kind]
        held, sizes, shares = [], [], []
        for each in right:
            first, last = each.finding.between_days or (math.inf, -math.inf)
            held.append(first <= change.at[each.scanner] <= last)
            if (size := each.finding.change) is not None:
                sizes.append((size.cor_column_mm - change.size) / size.deviations[0])
                shares.append(size.cor_column_mm / change.size)
        print(
            f"{change.name:28s} {len(findings) / len(looks):5.1%} {np.median(looks):7.0f} "
            f"{np.quantile(looks, 0.9, method='higher'):6.0f}   {len(right) / max(len(findings), 1):9.1%}  "
            f"{np.mean(held):16.1%}  {np.mean(np.abs(sizes) < 1.96):21.1%}  {np.median(shares):12.2f}"
        )


def print_alarms(alarms: FloatArray, years: FloatArray) -> None:
    """Print one line a limit."""
    print(f"{'':6s}  {'by the looks errors alone':>42s}  {'other logs allowed for':>24s}")
    print("limit   alarms  scanner years  a year (95 % interval)       alarms  a year")
    for k, limit in enumerate(LIMITS):
        number, over = alarms[0, k], years[0, k]
        low, high = gammaincinv(number, 0.025) if number else 0.0, gammaincinv(number + 1.0, 0.975)
        print(
            f"{limit:5.0f}  {number:7.0f}  {over:13.1f}  {number / over:6.2f} ({low / over:.2f} to {high / over:.2f})"
            f"  {alarms[1, k]:12.0f}  {alarms[1, k] / years[1, k]:6.2f}"
        )


def print_baselines(alarms: FloatArray, baselines: int) -> None:
    """Print the false alarms at the chart's limit."""
    number = alarms[:, int(np.flatnonzero(LIMITS == LIMIT)[0])]
    high: FloatArray = np.asarray(gammaincinv(number + 1.0, 0.975)) / baselines
    for name, count, most in zip(("by the looks' errors alone", "other logs allowed for"), number, high, strict=True):
        print(
            f"{name}: {count:.0f} of {baselines} baselines hold a jump that is none; at a calibration each week "
            f"{52.0 * count / baselines:.4f} a year, at most {52.0 * most:.4f}"
        )
    print("by limit, alone:", dict(zip(LIMITS.tolist(), alarms[0].tolist(), strict=True)))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--errors", type=Path, default=OUT.with_suffix(".npz"))
    parser.add_argument("--scanners", type=int, default=200)
    parser.add_argument("--days", type=float, default=36.0)
    parser.add_argument("--batches", type=int, default=2)
    parser.add_argument("--baselines", type=int, default=400_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    if not options.errors.exists():
        parser.error(f"there is no {options.errors}: run benchmarks/production_logs.py --logs 375 first")
    errors = Errors.read(options.errors)
    rng = np.random.default_rng(options.seed)
    quantiles = np.quantile(np.linalg.norm(errors.shape, axis=1), [0.5, 0.9, 0.97, 0.99, 0.997])
    size = np.sqrt(0.5 * np.sum(errors.scatter**2, axis=(1, 2)))
    print(f"{len(errors.shape)} looks at {len(errors.scatter)} scanners")
    print(f"scatter by the covariances: {size.min():.2f} to {size.max():.2f}, median {np.median(size):.2f}")
    print(f"distances at 50, 90, 97, 99, 99.7 %: {quantiles.round(2)}; normal ones are at 1.18 2.15 2.65 3.03 3.41")
    print(f"fifty looks pooled place u_c to {np.median(errors.of_fifty):.4f} mm, at most {errors.of_fifty.max():.4f}")
    print(f"exponent of the tail beyond {TAIL:.0%}: {errors.exponent:.1f}")
    batches = [false_alarms(errors, options.scanners, options.days, rng) for _ in range(options.batches)]
    print_alarms(*(np.sum(each, axis=0) for each in zip(*batches, strict=True)))
    print_baselines(alarms_of_baselines(errors, options.baselines, rng), options.baselines)
    print_delays(errors, options.scanners, rng)


if __name__ == "__main__":
    main()
