"""Run lengths of the drift chart: false alarms a year, and the looks until a jump or a trend is found.

    python benchmarks/look_errors.py
    python benchmarks/run_lengths.py [--errors FILE] [--scanners 200] [--days 36] [--batches 2]

Each simulated scanner draws its looks' errors and covariances from those of one scanner of `look_errors`, 2 000 a day:
that scanner's covariances, errors of the size that it has by them, and the shape of the errors of all. Beyond the
97 % quantile the errors are drawn from a Pareto tail with Hill's exponent. False alarms are counted with the looks'
errors alone, without what the chart allows other logs to do; intervals are Poisson's of 95 %.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from look_errors import OUTPUT
from numpy.typing import NDArray
from rich.progress import track
from scipy.stats import chi2

from sawmill_worker.tomography.drift_chart.alternatives import Alternatives
from sawmill_worker.tomography.drift_chart.chart import GROUP_LOOKS, LIMIT, QUIET, DriftKind, Finding, likelier
from sawmill_worker.tomography.drift_chart.history import History
from sawmill_worker.tomography.drift_chart.looks import BASELINE_LOOKS, pooled_means
from sawmill_worker.tomography.drift_chart.matrices import inverse, scaled
from sawmill_worker.tomography.drift_chart.scatter import Scatter
from sawmill_worker.tomography.geometry import FloatArray

LOOKS_A_DAY, DAYS_A_YEAR = 2000, 365.0
GROUPS_A_DAY = LOOKS_A_DAY // GROUP_LOOKS
LIMITS = np.arange(22.0, 41.0, 2.0)
TAIL = 0.97
# A scanner's covariances that are drawn from, and the distance of an error beyond which it says no more of the spread.
LOOKS_OF_EACH, MOST_OF_SPREAD = 20, 4.0
AT_A_TIME = 50
JUMPS_MM, TREND_MM_A_DAY = (0.02, 0.05, 0.1, 0.2), 0.01
# Days of quiet before a change, and after it until it counts as not found.
QUIET_DAYS, LONGEST_DAYS = 1.0, 6.0


@dataclass(frozen=True, eq=False)
class Errors:
    """Standardised errors of looks.

    Attributes
    ----------
    shape : (looks, 2) float64
        Of all scanners, whitened, of unit covariance in each scanner.
    roots : (scanners, looks, 2, 2) float64
        What the covariances are the squares of.
    scatter : (scanners, 2, 2) float64
        Lower Cholesky factors of what a scanner's whitened errors scatter by.
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
        """Against each scanner's mean, which stays."""
        table = np.load(path)
        shapes, roots, scatters = [], [], []
        for mill in np.unique(table["mill"]):
            at = table["mill"] == mill
            errors, covariances = table["error"][at], table["covariance"][at]
            number = len(errors)
            root = np.linalg.cholesky(covariances)
            rest = errors - pooled_means(errors, covariances).mean
            white = np.linalg.solve(root, rest[..., None])[..., 0] * math.sqrt(number / (number - 1))
            # As a scanner's spread; an outlier is one of the shape.
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
        """Errors (scanners, looks, 2) with their covariances (scanners, looks, 2, 2)."""
        size = (len(scanner), looks)
        white = self.shape[rng.integers(len(self.shape), size=size)]
        radius = np.linalg.norm(white, axis=-1)
        tail = self.from_radius * rng.uniform(size=size) ** (-1.0 / self.exponent)
        white *= np.where(radius > self.from_radius, tail / radius, 1.0)[..., None]
        root = self.roots[scanner[:, None], rng.integers(self.roots.shape[1], size=size)]
        errors = np.einsum("...ij,...j->...i", root @ self.scatter[scanner, None], white)
        return errors, root @ np.swapaxes(root, -1, -2)


Moved = Callable[[FloatArray], FloatArray]


def histories(
    errors: Errors, scanner: NDArray[np.intp], days: float, rng: np.random.Generator, moved: Moved | None = None
) -> Iterator[tuple[int, History]]:
    """Each scanner's history after each group, `moved` (looks,) in mm added to u_c at days (looks,)."""
    first_looks = errors.drawn(rng, scanner, BASELINE_LOOKS)
    zero, scatter = pooled_means(*first_looks), Scatter.of_looks(*first_looks)
    history = History.starting_at(np.zeros(len(scanner)), zero.mean, inverse(zero.precision), scatter)
    groups = round(days * GROUPS_A_DAY)
    for first in range(0, groups, AT_A_TIME):
        drawn, covariances = errors.drawn(rng, scanner, AT_A_TIME * GROUP_LOOKS)
        times = (first * GROUP_LOOKS + 1.0 + np.arange(AT_A_TIME * GROUP_LOOKS)) / LOOKS_A_DAY
        if moved is not None:
            drawn[..., 0] += moved(times)
        apart = (len(scanner), AT_A_TIME, GROUP_LOOKS)
        means = pooled_means(drawn.reshape(*apart, 2), covariances.reshape(*apart, 2, 2))
        spread, middle = inverse(means.precision), times.reshape(AT_A_TIME, GROUP_LOOKS).mean(axis=1)
        for k in range(min(AT_A_TIME, groups - first)):
            history = history.followed_by(np.full(len(scanner), middle[k]), means.mean[:, k], spread[:, k])
            yield first + k + 1, history


def false_alarms(errors: Errors, scanners: int, days: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """First alarms (2, limits), without and with what other logs may do, and the scanner years until them."""
    scanner = rng.integers(len(errors.scatter), size=scanners)
    alarms, groups = np.zeros((2, len(LIMITS))), np.zeros((2, len(LIMITS)))
    largest = np.zeros((2, scanners))
    for _, history in track(histories(errors, scanner, days, rng), total=round(days * GROUPS_A_DAY)):
        before = largest
        models = history.alternatives(QUIET)
        alone = [history.scatter.chi_squared(model.likelihood).max(axis=0) for model in models]
        allowing = [model.evidence.max(axis=0) for model in models]
        largest = np.maximum(largest, np.max([alone, allowing], axis=1))
        waiting = before[:, None] <= LIMITS[:, None]
        groups += waiting.sum(axis=2)
        alarms += (waiting & (largest[:, None] > LIMITS[:, None])).sum(axis=2)
    return alarms, groups / GROUPS_A_DAY / DAYS_A_YEAR


@dataclass(frozen=True)
class Found:
    """Of one change: the looks until the alarm, and the finding."""

    looks: int
    finding: Finding


def found(errors: Errors, scanners: int, moved: Moved, rng: np.random.Generator) -> tuple[list[Found], int]:
    """The findings at the alarms, and the number of false alarms before the change."""
    scanner = np.arange(scanners) % len(errors.scatter)
    waiting, early, findings = np.ones(scanners, bool), 0, []
    for group, history in histories(errors, scanner, QUIET_DAYS + LONGEST_DAYS, rng, moved):
        models = history.alternatives(QUIET)
        evidence = np.max([model.evidence.max(axis=0) for model in models], axis=0)
        for at in np.flatnonzero(waiting & (evidence > LIMIT)):
            of_one = (Alternatives(*(values[:, at] for values in vars(model).values())) for model in models)
            after = group * GROUP_LOOKS - round(QUIET_DAYS * LOOKS_A_DAY)
            waiting[at] = False
            if after <= 0:
                early += 1
            else:
                findings.append(Found(after, likelier(*of_one, float(history.segments[-1].last_days[at]))))
        if not waiting.any():
            break
    return findings, early


def of_jump(size_mm: float) -> Moved:
    """In the midst of a group."""
    return lambda days: size_mm * (days > QUIET_DAYS + 2.5 / LOOKS_A_DAY)


def of_trend(rate_mm: float) -> Moved:
    """Beginning after the quiet days."""
    return lambda days: rate_mm * np.maximum(days - QUIET_DAYS, 0.0)


def print_delays(errors: Errors, scanners: int, rng: np.random.Generator) -> None:
    """One line a change."""
    print(f"\nlooks from a change of u_c to its alarm; {scanners} scanners, limit {LIMIT}")
    print("change               found  median  90 %   right kind  time in interval  size within 1.96 s.d.")
    changes = [(f"jump {size:4.2f} mm", of_jump(size), DriftKind.JUMP, size) for size in JUMPS_MM]
    changes.append(("trend 0.01 mm a day", of_trend(TREND_MM_A_DAY), DriftKind.TREND, TREND_MM_A_DAY))
    for name, moved, kind, size in changes:
        findings, early = found(errors, scanners, moved, rng)
        looks = np.full(scanners - early, math.inf)
        looks[: len(findings)] = [each.looks for each in findings]
        right = [each.finding for each in findings if each.finding.kind is kind]
        times = [f.between_days for f in right if f.between_days is not None]
        held = np.mean([first <= QUIET_DAYS + 0.003 and last >= QUIET_DAYS for first, last in times])
        sizes = [(f.change[0] - size) / math.sqrt(f.covariance[0, 0]) for f in right if f.change is not None]
        print(
            f"{name:20s} {len(findings) / len(looks):5.1%} {np.median(looks):7.0f} {np.quantile(looks, 0.9):6.0f}"
            f"   {len(right) / len(findings):9.1%}  {held:16.1%}  {np.mean(np.abs(sizes) < 1.96):10.1%}"
        )


def print_alarms(alarms: FloatArray, years: FloatArray) -> None:
    """One line a limit."""
    print(f"{'':6s}  {'by the looks errors alone':>42s}  {'other logs allowed for':>24s}")
    print("limit   alarms  scanner years  a year (95 % interval)       alarms  a year")
    for k, limit in enumerate(LIMITS):
        number, over = alarms[0, k], years[0, k]
        low, high = chi2.ppf(0.025, 2.0 * number) / 2.0 if number else 0.0, chi2.ppf(0.975, 2.0 * number + 2.0) / 2.0
        print(
            f"{limit:5.0f}  {number:7.0f}  {over:13.1f}  {number / over:6.2f} ({low / over:.2f} to {high / over:.2f})"
            f"  {alarms[1, k]:12.0f}  {alarms[1, k] / years[1, k]:6.2f}"
        )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--errors", type=Path, default=OUTPUT)
    parser.add_argument("--scanners", type=int, default=200)
    parser.add_argument("--days", type=float, default=36.0)
    parser.add_argument("--batches", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
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
    print_delays(errors, options.scanners, rng)


if __name__ == "__main__":
    main()
