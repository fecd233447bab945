"""Drift checks as a mill meets them: production logs by a simulator that shares nothing with the fit.

    python benchmarks/production_logs.py [--logs 40] [--only plain wobble ...] [--out FILE] [--show] [--write]

Every ray is an exact chord through polygons (tests/support/exact_chords.py), in counts with flat fields and the noise
of 60 rows. A log has an outline that is not round, heartwood, a wet zone, up to six knots, and stands off centre; the
beam hardens by up to a tenth of the longest path. Most scans have 20 views all round, others 12, 45, 90 or 360. u_c
moved by 0, 0.05 or 0.2 mm since the calibration, whose SDD is wrong by 0.5 mm (standard deviation).

A class adds one thing that mills have:

- modules: a detector of two to four modules, which the calibration knows;
- wobble: the axis wobbles once and twice a turn by up to 0.3 mm each, across and along the beam;
- nails: one or two nails in every row;
- slide: by up to 1 mm during the scan the axis moves across the beam, or the log on the turntable;
- short turn: the views stand over 355 to 365 degrees and are stated over 360;
- slopes: the flat field slopes by 1 to 2 % from end to end;
- together: all of them at once, modules in half of the scanners and nails in 30 % of the logs.

Errors are of u_c on the detector, measured change less true change, mm. Where the axis moves during a scan the truth is
its mean place.

Each log is one JSON line; a run adds those that are missing, and the table shows all. `--write` writes
`benchmarks/results/production-logs.json`, if all lines are of the commit that is checked out.
"""

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from measurement import Measurement, check_lines, commit

from sawmill_tomography.drift.change import DriftError, drift_change
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import TAU, FloatArray, Scanner, SourceFrame
from sawmill_tomography.phantoms.phantom import Disc, Polygon, Shape
from sawmill_vocabulary import DetectorModule, Rotation

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests/support"))
from exact_chords import Detector, hardened, scan  # noqa: E402 - the tests' own

OUT = ROOT / "benchmarks/output/production-logs.jsonl"
CLASSES = ("plain", "modules", "wobble", "nails", "slide", "short turn", "slopes", "together")
VIEWS, VIEW_SHARES = (20, 12, 45, 90, 360), (0.64, 0.12, 0.12, 0.08, 0.04)
MOVED_MM = (0.0, 0.05, 0.2)
ROWS, FLATS, PHOTONS = 60, 10, 30_000.0
CELLS, PITCH_MM = 768, 1.5
# Standard deviations of the calibration: SDD, and each view's gain.
DISTANCE_ERROR_MM, GAIN = 0.5, 0.001
WOBBLE_MM, SLIDE_MM, SHORTEST_DEG, LONGEST_DEG = 0.3, 1.0, 355.0, 365.0
MOST_HARDENED, STEEL_PER_MM = 0.1, 0.35
CORNERS = 96


@dataclass(frozen=True, eq=False)
class Production:
    """A drift check of one log: what the program is given, and the truth.

    Attributes
    ----------
    rays : (views, cells) float64
        Mean line integrals of the rows.
    angles_rad : (views,) float64
        Angles as stated.
    moved_mm : float
        True change of u_c since the calibration.
    notes : dict
        What was drawn.
    """

    scanner: Scanner
    calibrated: SourceFrame
    rays: FloatArray
    angles_rad: FloatArray
    moved_mm: float
    notes: dict[str, Any]


def production(kind: str, number: int) -> Production:
    """Simulate a log of a class by its number."""
    rng = np.random.default_rng([CLASSES.index(kind), number])
    every = kind == "together"
    views, moved_mm = int(rng.choice(VIEWS, p=VIEW_SHARES)), float(rng.choice(MOVED_MM))
    calibrated = SourceFrame(
        rng.uniform(0.0, TAU), rng.uniform(700.0, 850.0), rng.uniform(1300.0, 1500.0), *rng.normal(0.0, [20.0, 0.05])
    )
    frame = replace(calibrated, cor_column_mm=calibrated.cor_column_mm + moved_mm)
    wrong_mm = float(rng.normal(0.0, DISTANCE_ERROR_MM))
    modules = _modules(rng) if kind == "modules" or (every and rng.uniform() < 0.5) else ()
    stated = rng.uniform(0.0, TAU) + np.arange(views) * TAU / views
    turn_deg = rng.uniform(SHORTEST_DEG, LONGEST_DEG) if kind == "short turn" or every else 360.0
    true = stated[0] + (stated - stated[0]) * turn_deg / 360.0
    moved = np.zeros((views, 2))
    notes: dict[str, Any] = {"views": views, "moved_mm": moved_mm, "modules": len(modules), "turn_deg": turn_deg}
    if kind == "wobble" or every:
        wobble, notes["wobble_mm"] = _wobble(rng, true)
        moved += wobble
    if kind == "slide" or every:
        slide, notes["slide_mm"], notes["slide"] = _slide(rng, true + frame.psi_rad)
        moved += slide
    metal = kind == "nails" or (every and rng.uniform() < 0.3)
    notes["nails"] = metal
    shapes = log_shapes(rng, nails=metal)
    longest = 2.0 * float(np.hypot(*np.array(shapes[0].vertices_mm).T).max()) * shapes[0].density  # type: ignore[union-attr]
    beam = hardened(rng.uniform(0.0, MOST_HARDENED) / longest)
    detector = Detector(CELLS, PITCH_MM, modules)
    transmission = scan(shapes, detector, frame, true, moved_mm=moved, beam=beam, rays=6)
    slope = rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.02) if kind == "slopes" or every else 0.0
    notes["slope"] = slope
    rays = _recorded(rng, transmission) + slope * np.linspace(-0.5, 0.5, CELLS)
    scanner = Scanner(
        source_to_cor_mm=calibrated.source_distance_mm,
        num_detector_pixels=CELLS,
        detector_pitch_mm=PITCH_MM,
        detector_modules=modules,
    )
    stated_frame = replace(calibrated, source_to_detector_mm=calibrated.source_to_detector_mm + wrong_mm)
    return Production(scanner, stated_frame, rays, stated, moved_mm, notes)


def log_shapes(rng: np.random.Generator, *, nails: bool) -> list[Shape]:
    """Draw a log's cross-section: the outline comes first, nails last."""
    radius = rng.uniform(80.0, 130.0)
    per_mm = rng.uniform(1.2, 2.4) / (2.0 * radius)
    around = np.arange(CORNERS) * TAU / CORNERS
    orders = np.arange(2, 7)
    waves = rng.normal(0.0, 0.06 / orders**1.3)
    outline = 1.0 + waves @ np.cos(np.outer(orders, around) + rng.uniform(0.0, TAU, (5, 1)))
    direction, off_mm = rng.uniform(0.0, TAU), 18.0 * math.sqrt(rng.uniform())
    centre = off_mm * np.array([math.cos(direction), math.sin(direction)])
    corners = np.stack([np.cos(around), np.sin(around)], axis=1)

    def body(place: FloatArray, size: FloatArray, density: float) -> Polygon:
        return Polygon(tuple(map(tuple, (centre + place + size[:, None] * corners).tolist())), density)

    pith = rng.normal(0.0, 0.06 * radius, 2)
    shapes: list[Shape] = [
        body(np.zeros(2), radius * outline, per_mm),
        body(pith, rng.uniform(0.4, 0.65) * radius * outline, -rng.uniform(0.05, 0.35) * per_mm),
    ]
    wet, towards = rng.uniform(0.1, 0.25) * radius, rng.uniform(0.0, TAU)
    at = rng.uniform(0.2, 0.65) * radius * np.array([math.cos(towards), math.sin(towards)])
    shapes.append(body(at, wet * (1.0 + 0.2 * np.cos(3.0 * around + towards)), rng.uniform(-0.25, 0.25) * per_mm))
    for _ in range(rng.integers(0, 7)):
        towards, length = rng.uniform(0.0, TAU), rng.uniform(0.3, 0.75) * radius
        shapes.append(_wedge(centre + pith, towards, length, rng.uniform(5.0, 20.0), rng.uniform(0.2, 1.0) * per_mm))
    for _ in range(rng.integers(1, 3) if nails else 0):
        towards, depth = rng.uniform(0.0, TAU), rng.uniform(0.55, 0.7) * radius
        place = centre + depth * np.array([math.cos(towards), math.sin(towards)])
        if rng.uniform() < 0.5:
            shapes.append(Disc((float(place[0]), float(place[1])), rng.uniform(1.2, 2.5), STEEL_PER_MM))
        else:
            # A nail drives inwards, by some 30 degrees to either side.
            inwards = towards + math.pi + rng.normal(0.0, 0.5)
            shapes.append(_rod(place, inwards, rng.uniform(15.0, 30.0), rng.uniform(2.5, 4.5)))
    return shapes


def _wedge(start: FloatArray, towards: float, length: float, width: float, per_mm: float) -> Polygon:
    along, across = np.array([math.cos(towards), math.sin(towards)]), np.array([-math.sin(towards), math.cos(towards)])
    ends = [start, start + length * along - 0.5 * width * across, start + length * along + 0.5 * width * across]
    return Polygon(tuple((float(x), float(y)) for x, y in ends), per_mm)


def _rod(middle: FloatArray, towards: float, length: float, width: float) -> Polygon:
    along, across = np.array([math.cos(towards), math.sin(towards)]), np.array([-math.sin(towards), math.cos(towards)])
    corners = [
        middle + 0.5 * (a * length * along + b * width * across) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return Polygon(tuple((float(x), float(y)) for x, y in corners), STEEL_PER_MM)


def _modules(rng: np.random.Generator) -> tuple[DetectorModule, ...]:
    """Draw two to four modules of equal length, with gaps of up to two cells and kinks of up to half a degree."""
    number = int(rng.integers(2, 5))
    return tuple(
        DetectorModule(
            CELLS * part // number, float(rng.uniform(0.0, 2.0 * PITCH_MM)), math.radians(rng.normal(0, 0.2))
        )
        for part in range(1, number)
    )


def _wobble(rng: np.random.Generator, angles_rad: FloatArray) -> tuple[FloatArray, list[float]]:
    """Draw the axis's motion (views, 2) in the laboratory, and its amplitudes once and twice a turn."""
    sizes = rng.uniform(0.0, WOBBLE_MM, 2)
    moved = np.zeros((len(angles_rad), 2))
    for order, size in zip((1, 2), sizes, strict=True):
        # An ellipse of any shape and position, whose larger half axis is the size.
        aspect, tilt, phase = rng.uniform(-1.0, 1.0), rng.uniform(0.0, TAU), rng.uniform(0.0, TAU)
        circle = np.stack([np.cos(order * angles_rad + phase), aspect * np.sin(order * angles_rad + phase)])
        turn = np.array([[math.cos(tilt), -math.sin(tilt)], [math.sin(tilt), math.cos(tilt)]])
        moved += size * (turn @ circle).T
    return moved, sizes.tolist()


def _slide(rng: np.random.Generator, beta_rad: FloatArray) -> tuple[FloatArray, float, str]:
    """Draw a slide at constant speed (views, 2) in the laboratory: of the axis, or of the log on the turntable."""
    size_mm, views = float(rng.uniform(0.0, SLIDE_MM)), len(beta_rad)
    gone = size_mm * (np.arange(views) - 0.5 * (views - 1)) / views
    if rng.uniform() < 0.5:
        return np.stack([gone * rng.choice([-1.0, 1.0]), np.zeros(views)], axis=1), size_mm, "axis"
    # The log turns with the table: its displacement turns with it.
    towards = rng.uniform(0.0, TAU) - beta_rad
    return np.stack([gone * np.cos(towards), gone * np.sin(towards)], axis=1), size_mm, "log"


def _recorded(rng: np.random.Generator, transmission: FloatArray) -> FloatArray:
    """Return the mean over the rows of -ln(counts / flat field), with gains of the cells and of the views."""
    cells = transmission.shape[1]
    light = PHOTONS * (1.0 + 0.1 * rng.standard_normal(cells).clip(-3.0, 3.0))
    flats = rng.poisson(light * FLATS, (ROWS, cells)) / FLATS
    of_views = 1.0 + GAIN * rng.standard_normal((len(transmission), 1))
    total = np.zeros_like(transmission)
    for flat in flats:
        total -= np.log(np.maximum(rng.poisson(light * of_views * transmission), 0.5) / flat)
    return total / ROWS


def checked(log: Production) -> dict[str, Any]:
    """Return the answer of the drift check as it is kept."""
    try:
        fit = detector_fit(log.scanner, log.rays, log.angles_rad, log.calibrated, Rotation.AS_GIVEN)
    except DriftError as refusal:
        return {"refused": refusal.code, "message": str(refusal)}
    calibration = np.zeros((5, 5))
    calibration[2, 2] = DISTANCE_ERROR_MM**2
    change = drift_change(log.scanner, log.calibrated, calibration, fit)
    return {
        "error_mm": float(change.change[0]) - log.moved_mm,
        "deviation_mm": float(change.deviation[0]),
        "tilt_rad": float(change.change[1]),
        "tilt_deviation_rad": float(change.deviation[1]),
        "moved": change.moved,
        "adjustments": list(fit.adjustments),
    }


def table(records: Sequence[dict[str, Any]]) -> str:
    """Format one line of each class and, over all classes, of each number of views."""
    columns = "logs  refused         mean error     RMS  median    s.d.   held tilt held  moved, of quiet"
    lines = [f"{'':24s} {columns}"]
    of_20 = [each for each in records if each["views"] == 20]
    groups = [(name, [each for each in records if each["class"] == name]) for name in CLASSES]
    groups += [(f"{name}, 20 views", [each for each in of_20 if each["class"] == name]) for name in CLASSES]
    groups += [(f"all, {views} views", [each for each in records if each["views"] == views]) for views in VIEWS]
    groups.append(("all", list(records)))
    lines += [f"{name:24s}{_line(group)}" for name, group in groups if group]
    return "\n".join(lines)


def _line(group: Sequence[dict[str, Any]]) -> str:
    refused = Counter(each["refused"] for each in group if "refused" in each)
    answered = [each for each in group if "refused" not in each]
    head = f"{len(group):5d} {refused.total() / len(group):8.1%}"
    if not answered:
        return f"{head}  {dict(refused)}"
    error, deviation = (np.array([each[key] for each in answered]) for key in ("error_mm", "deviation_mm"))
    tilt, tilt_deviation = (np.array([each[key] for each in answered]) for key in ("tilt_rad", "tilt_deviation_rad"))
    held, tilt_held = np.mean(np.abs(error) < 1.96 * deviation), np.mean(np.abs(tilt) < 1.96 * tilt_deviation)
    quiet = [each["moved"] for each in answered if each["moved_mm"] == 0.0]
    return (
        f"{head} {error.mean():+9.4f} +- {error.std() / math.sqrt(error.size):.4f} {np.sqrt(np.mean(error**2)):7.4f} "
        f"{np.median(np.abs(error)):7.4f} {np.median(deviation):7.4f} {held:6.1%} {tilt_held:9.1%} "
        f"{sum(quiet):8d} of {len(quiet):3d}  {dict(refused) or ''}"
    )


def summary(records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of the pages; errors are in mm on the detector, RMS ones of 20 views."""
    answered = [each for each in records if "refused" not in each]
    classes = {name: [each for each in answered if each["class"] == name] for name in CLASSES}
    held = {name: _held_percent(group) for name, group in classes.items()}
    worst = min(held, key=lambda name: held[name])
    singles = [_rms_mm(classes[name]) for name in CLASSES if name not in {"plain", "together"}]
    together = {nails: [each for each in classes["together"] if each["nails"] == nails] for nails in (False, True)}
    return {
        "logs": len(records),
        "refused": len(records) - len(answered),
        "held_percent": _held_percent(answered),
        "worst_held_percent": held[worst],
        "worst_logs": len(classes[worst]),
        "nails_mean_mm": max(
            abs(float(np.mean([each["error_mm"] for each in group]))) for group in (classes["nails"], together[True])
        ),
        "least_rms_mm": min(singles),
        "most_rms_mm": max(singles),
        "together_rms_mm": _rms_mm(together[False]),
        "together_nails_rms_mm": _rms_mm(together[True]),
    }


def _held_percent(group: Sequence[dict[str, Any]]) -> float:
    return 100.0 * float(np.mean([abs(each["error_mm"]) < 1.96 * each["deviation_mm"] for each in group]))


def _rms_mm(group: Sequence[dict[str, Any]]) -> float:
    return math.sqrt(float(np.mean([each["error_mm"] ** 2 for each in group if each["views"] == VIEWS[0]])))


def main() -> None:
    """Add the logs that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=40, help="logs of each class")
    parser.add_argument("--only", nargs="+", choices=CLASSES, default=CLASSES)
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--show", action="store_true", help="print the table of what is there, and add nothing")
    parser.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args()
    if options.write and len({*options.only}) < len(CLASSES):
        parser.error("--write needs all classes: leave out --only")
    measurement = Measurement.begin("worker/sawmill_tomography/drift") if options.write else None
    records = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {(each["class"], each["number"]) for each in records}
    missing = [(kind, number) for number in range(options.logs) for kind in options.only if (kind, number) not in done]
    options.out.parent.mkdir(exist_ok=True)
    with options.out.open("a") as file:
        for kind, number in () if options.show else missing:
            log = production(kind, number)
            records.append({"class": kind, "number": number, "commit": commit(), **log.notes, **checked(log)})
            file.write(json.dumps(records[-1]) + "\n")
            file.flush()
    print(table(records))
    if measurement is not None:
        check_lines(options.out)
        measurement.write({"production-logs": summary(records)}, timed=False)


if __name__ == "__main__":
    main()
