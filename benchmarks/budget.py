"""Each line of the uncertainty budget, next to the errors of scans that have its disturbance alone, from its own prior.

    python benchmarks/budget.py [--scans 500] [--only LINE] [--write]

An error is half the difference of two scans with the same noise and opposite disturbances, where both show the same
effects; or its square is the difference of the squares with the disturbance and without. Ten minutes of a core.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from measurement import Measurement
from rich.progress import track
from scipy.ndimage import gaussian_filter

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.joint_fit.effects import EFFECTS
from sawmill_tomography.calibration.joint_fit.groups import MOTIONS, PRIORS, unit_of
from sawmill_tomography.calibration.joint_fit.modules import HIDDEN_GAPS_CELLS, HIDDEN_KINKS_RAD
from sawmill_tomography.calibration.joint_fit.scan_model import POSE
from sawmill_tomography.calibration.joint_fit.slip import fewest, jump_at, slip_at
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.calibration.uncertainty_budget import uncertainty_budget
from sawmill_tomography.calibration.with_log import with_log
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Adjustment, DetectorModule, Disc, Handedness, Rotation

MEASURES = [
    f"worker/sawmill_tomography/{name}.py"
    for name in ("calibration/uncertainty_budget", "calibration/joint_fit/residual_statistics", "geometry/ray_error")
]
SCANNER, FRAME, VIEWS = Scanner(859.46, 256, 4.5), SourceFrame(0.3, 880.0, 1600.0, -30.0, -0.08), 180
NARROW = Scanner(859.46, 512, 2.25)  # in wide cells a log's rings are lost
ANGLES, STILL = TAU * np.arange(VIEWS) / VIEWS, np.zeros((VIEWS, 3))
Squares = Iterator[tuple[float, float]]  # squares of an error and of its line, mm² or per cent²


def projected(seen: Phantom = L_SHAPE, pose: FloatArray = STILL, scanner: Scanner = SCANNER) -> FloatArray:
    """Return the line integrals of a phantom with these poses of the views, (views, 3): psi, t_x, t_y."""
    return project(seen, DetectorCells.of(scanner), FRAME, ANGLES + pose[:, 0], position_mm=pose[:, 1:])


@cache
def noise(seed: int, scanner: Scanner = SCANNER) -> FloatArray:
    """Return noise of 1 mm."""
    return np.random.default_rng([seed, 5601]).standard_normal((VIEWS, scanner.num_detector_pixels))


def calibrated(
    lines: FloatArray, seed: int, scanner: Scanner = SCANNER, without: frozenset[Adjustment] = frozenset()
) -> CalibrationOutcome:
    """Calibrate a scan with noise."""
    noisy, side, sense = lines + noise(seed, scanner), Handedness.AS_DRAWN, Rotation.AS_GIVEN
    task = CalibrationTask(scanner, L_SHAPE, noisy, ANGLES, handedness=side, rotation=sense, without=without)
    return calibrate(task)


@cache
def undisturbed(seed: int) -> CalibrationOutcome:
    """Calibrate a scan that has noise alone."""
    return calibrated(projected(), seed)


def line(found: CalibrationOutcome, *sources: str) -> float:
    """Return the square of the lines of these sources together."""
    return sum(each.rays_mm**2 for each in uncertainty_budget(found) if each.source in sources)


def off(found: CalibrationOutcome, scanner: Scanner = SCANNER, frame: SourceFrame = FRAME) -> float:
    """Return the mean square of the distances to the rays of a geometry."""
    return ray_error(scanner, frame, found.frame, other_scanner=found.scanner, radius_mm=found.radius_mm).rms_mm ** 2


def growth(found: CalibrationOutcome, seed: int, *sources: str, scanner: Scanner = SCANNER) -> Squares:
    """Compare what the disturbance adds to the squares of the error, and of the lines of noise and of its sources."""
    before = undisturbed(seed)
    yield off(found, scanner) - off(before), line(found, "noise", *sources) - line(before, "noise")


def by_noise(seed: int) -> Squares:
    """Compare the errors of scans with other noise."""
    yield off(undisturbed(seed)), line(undisturbed(seed), "noise")


def by_opposites(source: str, disturb: Callable[..., Iterator[FloatArray]], seed: int) -> Squares:
    """Compare half the difference of scans with opposite disturbances."""
    one, other = (calibrated(each, seed) for each in disturb(np.random.default_rng([seed, 5602])))
    if {c for each in one.adjustments for c in each.codes} == {c for each in other.adjustments for c in each.codes}:
        yield 0.25 * off(one, other.scanner, other.frame), 0.5 * (line(one, source) + line(other, source))


def added(shape: Callable[..., FloatArray]) -> Callable[..., Iterator[FloatArray]]:
    """Return a disturbance that adds to line integrals."""

    def disturb(rng: np.random.Generator) -> Iterator[FloatArray]:
        values = shape(rng)
        yield from (projected() + values, projected() - values)

    return disturb


def jitter(rng: np.random.Generator) -> Iterator[FloatArray]:
    """Scatter the angles by 0.05 degrees."""
    pose = STILL + [math.radians(0.05), 0.0, 0.0] * rng.standard_normal((VIEWS, 1))
    yield from (projected(pose=sign * pose) for sign in (1.0, -1.0))


def knots(rng: np.random.Generator) -> Iterator[FloatArray]:
    """Add three knots to the long board, or take them away."""
    discs = [((rng.uniform(-90.0, -50.0), rng.uniform(-140.0, 140.0)), rng.uniform(5.0, 9.0)) for _ in range(3)]
    for density in (0.2, -0.2):
        wood = (*L_SHAPE.shapes, *(Disc(*each, density) for each in discs))
        yield projected(replace(L_SHAPE, shapes=wood))


def correlated(rng: np.random.Generator, views: float, cells: float) -> FloatArray:
    """Return noise of 0.5 mm that is alike in neighbouring views or cells."""
    values = gaussian_filter(rng.standard_normal((VIEWS, SCANNER.num_detector_pixels)), (views, cells), mode="wrap")
    return 0.5 * values / values.std()


def motions(seed: int) -> Squares:
    """Let each motion be there by its odds, with a size of any order of magnitude."""
    rng, pose, least = np.random.default_rng([seed, 5603]), STILL.copy(), fewest(VIEWS)
    # The columns of motions need no more of a model.
    model: Any = SimpleNamespace(data=SimpleNamespace(angles_rad=ANGLES), x=to_vector(FRAME), drawing=L_SHAPE)
    slips = [kind(int(rng.integers(least, VIEWS - least))) for kind in (slip_at, jump_at)]
    for effect in [*(each for each in EFFECTS if each.adjustment in MOTIONS), *slips]:
        prior = PRIORS[effect.adjustment]
        size = math.exp(rng.uniform(math.log(prior.low), math.log(prior.high)))
        if rng.random() < prior.odds / effect.trials:
            for column in effect.columns(model):
                drawn = size * unit_of(column, model) * rng.standard_normal()
                for term, shape in column.parts:
                    pose[:, POSE.index(term)] += drawn * shape
    yield from growth(calibrated(projected(pose=pose), seed), seed, "other-motions", "scatter")


@cache
def of_modules(seed: int) -> tuple[Scanner, CalibrationOutcome]:
    """Let the detector have up to three modules, each with odds of 2."""
    rng, there = np.random.default_rng([seed, 5604]), {}
    for _ in range(int(rng.binomial(3, 2.0 / 3.0))):
        kind, sign = int(rng.integers(2)), rng.choice([-1.0, 1.0])
        move = float(sign * rng.choice((SCANNER.detector_pitch_mm * HIDDEN_GAPS_CELLS, HIDDEN_KINKS_RAD)[kind]))
        there[int(rng.integers(8, SCANNER.num_detector_pixels - 8))] = (0.0, move) if kind else (move, 0.0)
    scanner = replace(SCANNER, detector_modules=tuple(DetectorModule(at, *there[at]) for at in sorted(there)))
    return scanner, calibrated(projected(scanner=scanner), seed)


def modules(seed: int, *, shown: bool) -> Squares:
    """Compare scans that pass, where some of the detector's modules are found, or none is."""
    try:
        scanner, found = of_modules(seed)
    except ZeroDivisionError:  # the fit may try a module before the first cell
        return
    if bool(found.scanner.detector_modules) is shown and found.judgement.rays_verdict == "pass":
        yield from growth(found, seed, "hidden-modules", scanner=scanner)


def switched_off(seed: int) -> Squares:
    """Let the phantom slip by about 1 mm at any view, which must not be fitted."""
    rng, pose = np.random.default_rng([seed, 5605]), STILL.copy()
    pose[int(rng.integers(20, VIEWS - 20)) :, 1:] = rng.standard_normal(2)
    found = calibrated(projected(pose=pose), seed, without=frozenset([Adjustment.SLIP]))
    yield from growth(found, seed, "effects-switched-off")


def held(seed: int) -> Squares:
    """Let the stated distance be too large, by about 5 mm."""
    wrong_mm = 5.0 * abs(np.random.default_rng([seed, 5606]).standard_normal())
    found = calibrated(projected(), seed, replace(SCANNER, source_to_cor_mm=FRAME.source_distance_mm + wrong_mm))
    if found.findings.source_distance.held:
        yield from growth(found, seed, "held-source-distance")


def cells(seed: int) -> Squares:
    """Let the cells lie elsewhere by waves of which the k-th is as 1 / k."""
    rng = np.random.default_rng([seed, 5607])
    waves = tuple((2.0 * rng.standard_normal(96) / np.arange(2, 98)).tolist())
    scanner = replace(SCANNER, detector_waves_mm=waves)
    found = calibrated(projected(scanner=scanner), seed)
    if found.scanner.detector_waves_mm:
        yield from growth(found, seed, "cell-places", scanner=scanner)


def log(seed: int) -> Squares:
    """Compare two logs next to one phantom."""
    alone = calibrated(projected(scanner=NARROW), seed, NARROW)
    pair = []
    for number in (2 * seed, 2 * seed + 1):
        wood = LogModel.random(number, radius_mm=110.0)
        rows = [projected(wood.slice_at(130.0 + 6.0 * row), scanner=NARROW) for row in range(8)]
        pair.append(with_log(alone, np.mean(rows, axis=0)))
    one, other = pair
    yield 0.5 * off(one, other.scanner, other.frame), 0.5 * (line(one, "log") + line(other, "log"))


def size(source: str, seed: int) -> Squares:
    """Let the phantom be larger by one standard uncertainty."""
    own = next(each for each in uncertainty_budget(undisturbed(seed)) if each.source == source)
    found = calibrated(projected(L_SHAPE.scaled(1.0 + 0.01 * own.scale_percent)), seed)
    seen = ray_error(SCANNER, undisturbed(seed).frame, found.frame, radius_mm=found.radius_mm).scale_change
    yield (100.0 * seen) ** 2, own.scale_percent**2


# Each line with what disturbs the scans, and the share of `--scans` that is simulated.
RUNS: dict[str, tuple[Callable[[int], Squares], float]] = {
    "noise": (by_noise, 1.0),
    "scatter: angles": (partial(by_opposites, "scatter", jitter), 0.3),
    "scatter: flat field of 100 frames": (
        partial(by_opposites, "scatter", added(lambda rng: 0.1 * rng.standard_normal(SCANNER.num_detector_pixels))),
        0.3,
    ),
    "misfit-within-views: alike in 7 cells": (
        partial(by_opposites, "misfit-within-views", added(lambda rng: correlated(rng, 0.0, 3.0))),
        0.06,
    ),
    "misfit-between-views: alike in 9 views": (
        partial(by_opposites, "misfit-between-views", added(lambda rng: correlated(rng, 4.0, 0.0))),
        0.3,
    ),
    "misfit-between-views: knots": (partial(by_opposites, "misfit-between-views", knots), 0.06),
    "other-motions": (motions, 1.0),
    "hidden-modules, none shown": (partial(modules, shown=False), 1.0),
    "hidden-modules, some shown": (partial(modules, shown=True), 1.0),
    "effects-switched-off": (switched_off, 0.1),
    "held-source-distance": (held, 0.1),
    "cell-places": (cells, 0.04),
    "log": (log, 0.08),
    "phantom-size": (partial(size, "phantom-size"), 0.01),
    "moisture": (partial(size, "moisture"), 0.01),
    "temperature": (partial(size, "temperature"), 0.01),
}


def main() -> None:
    """Compare all lines, print a table, and write the values."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scans", type=int, default=500, help="most scans of a line")
    parser.add_argument("--only", default="", help="lines whose names begin so")
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/budget.json")
    chosen, measurement = parser.parse_args(), Measurement.begin(*MEASURES)
    lines = ["| line, and disturbance | scans | RMS error, mm or % | line | line / error |", "|---" * 5 + "|"]
    for name, (run, share) in RUNS.items():
        if not name.startswith(chosen.only):
            continue
        every = range(max(2, round(share * chosen.scans)))
        squares = np.array([each for seed in track(every, name) for each in run(seed)])
        draws = np.random.default_rng(0).integers(len(squares), size=(400, len(squares)))
        ratios = np.sqrt(np.maximum(squares[draws, 1].mean(axis=1) / squares[draws, 0].mean(axis=1), 0.0))
        seen, stated = np.sqrt(np.maximum(squares.mean(axis=0), 0.0))
        ratio = f"{stated / seen:.2f} ± {ratios.std():.2f}"
        lines.append(f"| {name} | {len(squares)} | {seen:.3g} | {stated:.3g} | {ratio} |")
        print(lines[-1], flush=True)
    print("\n".join(lines))
    if chosen.write:
        measurement.write({"budget": {"table": "\n".join(lines)}}, timed=False)


if __name__ == "__main__":
    main()
