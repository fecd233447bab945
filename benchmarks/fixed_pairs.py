"""Scanners of fixed pairs: how far the rays of random machines are off, and whether the bound holds.

    python benchmarks/fixed_pairs.py [--machines 100] [--seed 1] [--kind NAME] [--passages N] [--out FILE] [--write]
    python benchmarks/fixed_pairs.py --table FILE

A machine has 2, 4 or 6 pairs in one plane, over half a turn, whose true places are off the nominal ones by 20 mm and
2 or 3 degrees (standard deviation). The L passes at random places and rolls, in counts with ten flat and dark fields;
rolls of several passages differ by 30 degrees at least. The kinds (`KINDS`) add effects. Results are appended to a file
of JSON lines; an interrupted study continues where it stopped.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measurement import Measurement, check_lines, commit
from rich.progress import track

from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, to_vector
from sawmill_tomography.pairs.calibrate import PairsTask, calibrate_pairs
from sawmill_tomography.pairs.passages import PairData, moved_frames
from sawmill_tomography.pairs.ray_errors import PairRays, rigid_motion
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.log_model import SAPWOOD_PER_MM
from sawmill_tomography.phantoms.phantom import Phantom, Polygon
from sawmill_tomography.physics.passages import Passage, PassedPair, simulate_passages
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import CellOrder, FixedPair, PairedScanner, SourceFrame
from sawmill_vocabulary.physics import BeamEffects, DetectorEffects, Physics, WoodEffects

PAIRS, ROWS, GROUPS, ROW_PITCH_MM, PHOTONS = (2, 4, 6), 20, 3, 2.0, 20_000.0
TOLERANCE_MM = 0.1
BEAM = BeamEffects(energy_spread=0.2, scatter_share=0.02, focal_blur_mm=0.3, flicker_share=0.003)
DETECTOR = DetectorEffects(blur_mm=0.8, gain_spread=0.03, slope_share=0.003)
# Of each kind: physics, standard deviation of the body's corners about the drawing's, mm, and of slopes along the feed.
KINDS: dict[str, tuple[Physics, float, float]] = {
    "counts alone": (Physics(), 0.0, 0.0),
    "beam and detector": (Physics(BEAM, DETECTOR), 0.0, 0.0),
    "slopes and twist": (Physics(BEAM, DETECTOR), 0.0, 1.0),
    "corners 0.3 mm off": (Physics(BEAM, DETECTOR), 0.3, 0.0),
    "worn wood": (
        Physics(BEAM, DETECTOR, wood=WoodEffects(corner_radius_mm=2.0, density_slope_percent=2.0, roughness_mm=0.1)),
        0.0,
        0.0,
    ),
    "a knot": (Physics(BEAM, DETECTOR, wood=WoodEffects(knots=1)), 0.0, 0.0),
}
Line = dict[str, Any]


def machine(pairs: int, rng: np.random.Generator) -> tuple[PairedScanner, list[SourceFrame]]:
    """Draw a machine: its nominal places, and the true frames."""
    first, nominal, true = rng.uniform(0.0, 360.0), [], []
    for number in range(pairs):
        distance = rng.uniform(750.0, 950.0)
        pair = FixedPair(
            angle_deg=math.remainder(first + 180.0 * number / pairs, 360.0),
            source_distance_mm=distance,
            source_to_detector_mm=distance + rng.uniform(550.0, 800.0),
            num_detector_pixels=768,
            detector_pitch_mm=1.2,
            cor_column_mm=rng.uniform(-20.0, 20.0),
            detector_tilt_deg=rng.uniform(-3.0, 3.0),
            cell_order=CellOrder.CLOCKWISE,
        )
        nominal.append(pair)
        off = rng.standard_normal(5) * [math.radians(3.0), 20.0, 20.0, 20.0, math.radians(2.0)]
        true.append(SourceFrame.from_vector(to_vector(pair.frame) + off))
    return PairedScanner(tuple(nominal)), true


def passages(count: int, slopes: float, rng: np.random.Generator) -> list[Passage]:
    """Draw how the board lies, until no two rolls are alike."""
    while True:
        rolls = rng.uniform(0.0, 2.0 * math.pi, count)
        apart = np.abs(np.angle(np.exp(1j * (rolls[:, None] - rolls))))
        if (apart + 10.0 * np.eye(count) > math.radians(30.0)).all():
            break
    along = slopes * rng.standard_normal((count, 3)) * [0.003, 0.003, 1e-4]
    places = rng.uniform(-25.0, 25.0, (count, 2))
    return [
        Passage((float(x), float(y)), float(roll), (float(dx), float(dy)), float(twist))
        for (x, y), roll, (dx, dy, twist) in zip(places, rolls, along, strict=True)
    ]


def body(corners_mm: float, rng: np.random.Generator) -> tuple[Phantom, Phantom]:
    """Return the drawing about its middle, and a body whose corners are off it."""
    drawing = L_SHAPE.centred()
    shapes = tuple(
        replace(
            shape,
            vertices_mm=tuple(
                (float(x), float(y))
                for x, y in np.array(shape.vertices_mm) + corners_mm * rng.standard_normal((len(shape.vertices_mm), 2))
            ),
        )
        for shape in drawing.shapes
        if isinstance(shape, Polygon)
    )
    return drawing, replace(drawing, shapes=shapes).of_density(0.6 * SAPWOOD_PER_MM)


def lines_of(passed: PassedPair) -> FloatArray:
    """Return line integrals, (passages, rows, cells)."""
    dark = passed.darks.mean(axis=0)
    return np.asarray(-np.log(np.maximum(passed.counts - dark, 1.0) / (passed.flats.mean(axis=0) - dark)))


def data_of(passed: PassedPair, pair: FixedPair) -> PairData:
    """Return line integrals, as means over groups of rows."""
    heights = (np.arange(ROWS) - 0.5 * (ROWS - 1)) * ROW_PITCH_MM + pair.feed_offset_mm
    parts = np.array_split(np.arange(ROWS), GROUPS)
    lines = np.stack([lines_of(passed)[:, rows].mean(axis=1) for rows in parts], axis=1)
    return PairData(lines, np.array([heights[rows].mean() for rows in parts]), DetectorCells.of(pair.scanner))


class PairRayError(NamedTuple):
    """Distances in mm after the common rigid motion and scale that make their RMS least."""

    rms_mm: float
    of_pairs_mm: list[float]
    scale_change: float  # by this share the other geometry is larger


def pair_ray_error(true: PairRays, frames: FloatArray) -> PairRayError:
    """Compute the RMS distance between true rays and rays of other frames (pairs, 5), of all and of each pair."""
    placed, scale = moved_frames(frames, rigid_motion(true, frames).tolist()), 1.0
    for _ in range(10):
        *motion, larger = np.linalg.lstsq(true.gauge, -true.distances(placed))[0].tolist()
        placed, scale = moved_frames(placed * [1.0, 1.0 + larger, 1.0, 1.0, 1.0], motion), scale * (1.0 + larger)
    squares = true.distances(placed) ** 2
    own = [math.sqrt(squares[true.of_pair == pair].mean()) for pair in range(len(frames))]
    return PairRayError(math.sqrt(squares.mean()), own, 1.0 / scale - 1.0)


def outcome(kind: str, number: int, count: int, seed: int) -> Line:
    """Return what a calibration of one machine gives."""
    rng = np.random.default_rng((seed, list(KINDS).index(kind), number, count))
    physics, corners_mm, slopes = KINDS[kind]
    scanner, true = machine(PAIRS[number % len(PAIRS)], rng)
    drawing, made = body(corners_mm, rng)
    passed = simulate_passages(
        made,
        scanner,
        true,
        passages(count, slopes, rng),
        physics,
        rows=ROWS,
        row_pitch_mm=ROW_PITCH_MM,
        photons=PHOTONS,
        seed=int(rng.integers(2**31)),
    )
    data = [data_of(*each) for each in zip(passed, scanner.pairs, strict=True)]
    about: Line = {"kind": kind, "number": number, "passages": count, "pairs": len(scanner.pairs)}
    before = time.process_time()
    try:
        found = calibrate_pairs(PairsTask(scanner, drawing, data))
    except GeometryError as error:
        return about | {"refused": str(error)}
    seconds = time.process_time() - before
    rays = PairRays([pair.scanner for pair in scanner.pairs], np.array([*map(to_vector, true)]), found.radius_mm)
    error = pair_ray_error(rays, np.array([to_vector(pair.frame) for pair in found.pairs]))
    return about | {
        "error_mm": error.rms_mm,
        "upper_95_mm": found.rays.upper_95_mm,
        "scale_error_percent": 100.0 * error.scale_change,
        "scale_uncertainty_percent": found.scale_percent_95,
        "verdict": found.verdict,
        "seconds": seconds,
        "reasons": [code for reason in found.reasons for code in reason.codes],
    }


def summary(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the figures of the page, by kind and number of passages."""
    rows: dict[str, Any] = {}
    for kind in KINDS:
        for count in sorted({line["passages"] for line in lines}):
            own = [one for one in lines if one["kind"] == kind and one["passages"] == count and "refused" not in one]
            if own:
                rows[f"{kind}, {count}"] = _figures(own)
    whole = [
        "| kind | passages | machines | error: median, 95 % | bound: median | bound holds | pass | wrong passes |",
        "|---|---|---|---|---|---|---|---|",
        *(ROW.format(*name.rsplit(", ", 1), **row) for name, row in rows.items()),
    ]
    return {
        "machines": len(lines),
        "refused": sum("refused" in line for line in lines),
        "wrong": sum(row["wrong"] for row in rows.values()),
        "table": "\n".join(whole),
        "kinds": rows,
    }


ROW = (
    "| {} | {} | {machines} | {median_mm:.3f}, {of_95_mm:.3f} mm | {bound_mm:.3f} mm | {holds_percent:.0f} % | "
    "{passed_percent:.0f} % | {wrong} |"
)


def _figures(lines: Sequence[Line]) -> dict[str, Any]:
    errors, bounds = (np.array([line[name] for line in lines]) for name in ("error_mm", "upper_95_mm"))
    passed = np.array([line["verdict"] == "pass" for line in lines])
    return {
        "machines": len(lines),
        "median_mm": round(float(np.median(errors)), 4),
        "of_95_mm": round(float(np.quantile(errors, 0.95)), 4),
        "bound_mm": round(float(np.median(bounds)), 4),
        "holds_percent": round(100.0 * float(np.mean(errors <= bounds)), 1),
        "passed_percent": round(100.0 * float(passed.mean()), 1),
        "wrong": int((passed & (errors > TOLERANCE_MM)).sum()),
        "seconds": round(float(np.median([line["seconds"] for line in lines])), 2),
    }


def _missing(done: Sequence[Line], arguments: argparse.Namespace) -> Iterator[tuple[str, int, int]]:
    there = {(line["kind"], line["number"], line["passages"]) for line in done}
    for number in range(arguments.machines):
        for kind in [arguments.kind] if arguments.kind else KINDS:
            for count in arguments.passages:
                if (kind, number, count) not in there:
                    yield kind, number, count


def main() -> None:
    """Run the study, or print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--passages", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--out", type=Path, default=Path("build/fixed_pairs.jsonl"))
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--table", type=Path, metavar="RESULTS", help="only print the table of these results")
    way.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args()
    measurement = Measurement.begin("worker/sawmill_tomography/pairs") if options.write else None
    path = options.table or options.out
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if options.table is None:
        made = {"seed": options.seed, "commit": commit()}
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as out:
            for each in track([*_missing(lines, options)], description="machines"):
                lines.append(outcome(*each, options.seed) | made)
                out.write(json.dumps(lines[-1]) + "\n")
                out.flush()
    print(summary(lines)["table"])
    if measurement is not None:
        check_lines(path, seed=options.seed)
        measurement.write({"fixed-pairs": summary(lines)}, timed=False)


if __name__ == "__main__":
    main()
