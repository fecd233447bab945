"""Each line of the uncertainty budget, next to the errors of scans that have its disturbance alone, from its own prior.

    python benchmarks/budget.py [--scans 500] [--only LINE] [--write]

An error is half the difference of two scans with the same noise and opposite disturbances, where both show the same
effects; or its square is the difference of the squares with the disturbance and without. Ten minutes of a core.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from measurement import Measurement
from rich.progress import track
from scipy.ndimage import gaussian_filter

from sawmill_tomography.calibration import calibrate, task, uncertainty_budget, with_log
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.joint_fit import effects, groups, modules, scan_model, slip
from sawmill_tomography.effect_priors import PRIORS
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, SourceFrame, to_vector
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import Adjustment, DetectorModule, Disc, Handedness, Rotation

MEASURED = ("uncertainty_budget", "joint_fit/residual_statistics", "joint_fit/motion_sets", "joint_fit/modules")
FRAME, VIEWS, CELLS = SourceFrame(0.3, 880.0, 1600.0, -30.0, -0.08), 180, 256
FLAT, NARROW = Scanner(859.46, CELLS, 4.5), Scanner(859.46, 512, 2.25)  # in wide cells a log's rings are lost
ANGLES, STILL = TAU * np.arange(VIEWS) / VIEWS, np.zeros((VIEWS, 3))
# Each line with what disturbs the scans, and the share of `--scans` that is simulated.
LINES = {
    "noise": 1.0,
    "scatter: angles": 0.3,
    "scatter: flat field of 100 frames": 0.3,
    "misfit-within-views: alike in 7 cells": 0.06,
    "misfit-between-views: alike in 9 views": 0.3,
    "misfit-between-views: knots": 0.06,
    "other-motions": 1.0,
    "hidden-modules, none shown": 1.0,
    "hidden-modules, some shown": 1.0,
    "effects-switched-off": 0.1,
    "held-source-distance": 0.1,
    "cell-places": 0.04,
    "log": 0.08,
    "phantom-size": 0.01,
    "moisture": 0.01,
    "temperature": 0.01,
}


def projected(seen: Phantom = L_SHAPE, pose: FloatArray = STILL, scanner: Scanner = FLAT) -> FloatArray:
    """Return the line integrals of a phantom with these poses of the views, (views, 3): psi, t_x, t_y."""
    return project(seen, DetectorCells.of(scanner), FRAME, ANGLES + pose[:, 0], position_mm=pose[:, 1:])


def calibrated(lines: FloatArray, seed: int, scanner: Scanner = FLAT, *without: Adjustment) -> CalibrationOutcome:
    """Calibrate a scan with noise of 1 mm."""
    noisy = lines + np.random.default_rng([seed, 5601]).standard_normal(lines.shape)
    known = {"handedness": Handedness.AS_DRAWN, "rotation": Rotation.AS_GIVEN, "without": frozenset(without)}
    return calibrate.calibrate(task.CalibrationTask(scanner, L_SHAPE, noisy, ANGLES, **known))


@cache
def undisturbed(seed: int) -> CalibrationOutcome:
    """Calibrate a scan that has noise alone."""
    return calibrated(projected(), seed)


def line(found: CalibrationOutcome, *sources: str, field: str = "rays_mm") -> float:
    """Return the square of the lines of these sources together."""
    budget = uncertainty_budget.uncertainty_budget(found)
    return sum(getattr(each, field) ** 2 for each in budget if each.source in sources)


def off(found: CalibrationOutcome, scanner: Scanner = FLAT, frame: SourceFrame = FRAME) -> float:
    """Return the mean square of the distances to the rays of a geometry."""
    return ray_error(scanner, frame, found.frame, other_scanner=found.scanner, radius_mm=found.radius_mm).rms_mm ** 2


def opposites(name: str, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Return two scans with opposite disturbances."""
    if name.endswith("angles"):
        pose = STILL + [math.radians(0.05), 0.0, 0.0] * rng.standard_normal((VIEWS, 1))
        return (projected(pose=sign * pose) for sign in (1.0, -1.0))
    if name.endswith("knots"):
        discs = [((rng.uniform(-90.0, -50.0), rng.uniform(-140.0, 140.0)), rng.uniform(5.0, 9.0)) for _ in range(3)]
        wood = ((*L_SHAPE.shapes, *(Disc(*each, density) for each in discs)) for density in (0.2, -0.2))
        return (projected(replace(L_SHAPE, shapes=shapes)) for shapes in wood)
    if name.endswith("frames"):
        values = 0.1 * rng.standard_normal(CELLS)
    else:
        alike = (4.0, 0.0) if name.endswith("views") else (0.0, 3.0)
        values = gaussian_filter(rng.standard_normal((VIEWS, CELLS)), alike, mode="wrap")
        values *= 0.5 / values.std()
    return (projected() + sign * values for sign in (1.0, -1.0))


def motions(rng: np.random.Generator) -> FloatArray:
    """Let each motion be there by its odds, with a size of any order of magnitude; return the poses."""
    pose, least = STILL.copy(), slip.fewest(VIEWS)
    # The columns of motions need no more of a model.
    model: Any = SimpleNamespace(data=SimpleNamespace(angles_rad=ANGLES), x=to_vector(FRAME), drawing=L_SHAPE)
    slips = [kind(int(rng.integers(least, VIEWS - least))) for kind in (slip.slip_at, slip.jump_at)]
    for effect in [*(each for each in effects.EFFECTS if each.adjustment in groups.MOTIONS), *slips]:
        prior = PRIORS[effect.adjustment]
        size = math.exp(rng.uniform(math.log(prior.low), math.log(prior.high)))
        if rng.random() < prior.odds / effect.trials:
            for column in effect.columns(model):
                drawn = size * groups.unit_of(column, model) * rng.standard_normal()
                for term, shape in column.parts:
                    pose[:, scan_model.POSE.index(term)] += drawn * shape
    return pose


def of_modules(rng: np.random.Generator) -> Scanner:
    """Return a detector of up to three further modules, each with odds of 2."""
    sizes, there = np.outer([1.0, groups.KINK_RAD_PER_MM], modules.PRIOR.sizes), {}
    for _ in range(int(rng.binomial(3, 2.0 / 3.0))):
        kind, sign = int(rng.integers(2)), rng.choice([-1.0, 1.0])
        move = float(sign * rng.choice(sizes[kind]))
        there[int(rng.integers(8, CELLS - 8))] = (0.0, move) if kind else (move, 0.0)
    return replace(FLAT, detector_modules=tuple(DetectorModule(at, *there[at]) for at in sorted(there)))


@cache
def disturbed(source: str, seed: int) -> tuple[CalibrationOutcome, Scanner]:
    """Calibrate a disturbed scan; return the true scanner too."""
    number = ["other-motions", "hidden-modules", "effects-switched-off", "held-source-distance", "cell-places"]
    rng, pose = np.random.default_rng([seed, 5603 + number.index(source)]), STILL.copy()
    match source:
        case "other-motions":
            return calibrated(projected(pose=motions(rng)), seed), FLAT
        case "effects-switched-off":
            pose[int(rng.integers(20, VIEWS - 20)) :, 1:] = rng.standard_normal(2)
            return calibrated(projected(pose=pose), seed, FLAT, Adjustment.SLIP), FLAT
        case "held-source-distance":
            stated_mm = FRAME.source_distance_mm + 5.0 * abs(rng.standard_normal())
            return calibrated(projected(), seed, replace(FLAT, source_to_cor_mm=stated_mm)), FLAT
        case "hidden-modules":
            true = of_modules(rng)
        case _:  # waves of which the k-th is as 1 / k
            true = replace(FLAT, detector_waves_mm=tuple((2.0 * rng.standard_normal(96) / np.arange(2, 98)).tolist()))
    return calibrated(projected(scanner=true), seed), true


def compared(name: str, seed: int) -> tuple[float, float] | None:
    """Return the squares of an error and of its line, mm² or per cent²; None where the scan does not count."""
    source, before = name.partition(":")[0].partition(",")[0], undisturbed(seed)
    if name == "noise":
        return off(before), line(before, "noise")
    if name in {"phantom-size", "moisture", "temperature"}:
        square = line(before, name, field="scale_percent")
        larger = calibrated(projected(L_SHAPE.scaled(1.0 + 0.01 * math.sqrt(square))), seed)
        change = ray_error(FLAT, before.frame, larger.frame, radius_mm=before.radius_mm).scale_change
        return (100.0 * change) ** 2, square
    if name == "log":
        alone = calibrated(projected(scanner=NARROW), seed, NARROW)
        woods = [LogModel.random(2 * seed + number, radius_mm=110.0) for number in (0, 1)]
        rows = [[projected(wood.slice_at(130.0 + 6.0 * row), scanner=NARROW) for row in range(8)] for wood in woods]
        one, other = (with_log.with_log(alone, np.mean(each, axis=0)) for each in rows)
        return 0.5 * off(one, other.scanner, other.frame), 0.5 * (line(one, name) + line(other, name))
    if ":" in name:
        one, other = (calibrated(lines, seed) for lines in opposites(name, np.random.default_rng([seed, 5602])))
        codes = ({code for each in found.adjustments for code in each.codes} for found in (one, other))
        stated = 0.5 * (line(one, source) + line(other, source))
        return (0.25 * off(one, other.scanner, other.frame), stated) if next(codes) == next(codes) else None
    found, true = disturbed(source, seed)
    shown = bool(found.scanner.detector_modules) is name.endswith("some shown")
    counts = {
        "hidden-modules": shown and found.judgement.rays_verdict == "pass",
        "held-source-distance": found.findings.source_distance.held,
        "cell-places": bool(found.scanner.detector_waves_mm),
    }
    own = ("noise", source, {"other-motions": "scatter", "hidden-modules": "found-modules"}.get(source, ""))
    added = off(found, true) - off(before), line(found, *own) - line(before, "noise")
    return added if counts.get(source, True) else None


def main() -> None:
    """Compare all lines, print a table, and write the values."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scans", type=int, default=500, help="most scans of a line")
    parser.add_argument("--only", default="", help="lines whose names begin so")
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/budget.json")
    chosen = parser.parse_args()
    measurement = Measurement.begin(*(f"worker/sawmill_tomography/calibration/{name}.py" for name in MEASURED))
    lines = ["| line, and disturbance | scans | RMS error, mm or % | line | line / error |", "|---" * 5 + "|"]
    for name, share in LINES.items():
        if name.startswith(chosen.only):
            found = [compared(name, seed) for seed in track(range(max(2, round(share * chosen.scans))), name)]
            squares = np.array([each for each in found if each is not None])
            draws = squares[np.random.default_rng(0).integers(len(squares), size=(400, len(squares)))].mean(axis=1)
            (seen, stated), ratios = np.sqrt(squares.mean(axis=0)), np.sqrt(draws[:, 1] / draws[:, 0])
            ratio = f"{stated / seen:.2f} ± {np.nanstd(ratios):.2f}"
            lines.append(f"| {name} | {len(squares)} | {seen:.3g} | {stated:.3g} | {ratio} |")
            print(lines[-1], flush=True)
    if chosen.write:
        measurement.write({"budget": {"table": "\n".join(lines)}}, timed=False)


if __name__ == "__main__":
    main()
