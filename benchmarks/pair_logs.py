"""Logs on scanners of fixed pairs: how far nails are located, false marks, and whether the pairs are said to agree.

    python benchmarks/pair_logs.py [--logs 100] [--seed 1] [--out FILE] [--write]

A machine of `fixed_pairs.py` is calibrated from two passages of the L; then logs with four nails and a piece of metal
pass, with scattered radiation, hardening and blur. Before a second check the rays of the second pair move by 2 mm.
Results are appended to a file of JSON lines; an interrupted study continues where it stopped.
"""

import argparse
import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fixed_pairs import BEAM, DETECTOR, PHOTONS, ROW_PITCH_MM, ROWS, body, data_of, lines_of, machine, passages
from measurement import Measurement, check_lines, commit
from rich.progress import track

from sawmill_tomography.geometry.geometry import FloatArray, SourceFrame, rotate, to_vector
from sawmill_tomography.pairs.agreement import agreement
from sawmill_tomography.pairs.calibrate import FoundPairs, PairsTask, calibrate_pairs
from sawmill_tomography.pairs.log_pictures import log_pictures
from sawmill_tomography.pairs.marks import Sights
from sawmill_tomography.pairs.ray_errors import PairRays, rigid_motion
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.physics.passages import simulate_passages
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary import PairedScanner
from sawmill_vocabulary.physics import Physics

# Number of pairs, logs for each machine, by what the second pair's rays move, and the distance within which a mark is
# the metal's.
PAIRS, LOGS_EACH, MOVED_MM, NEAR_MM = (2, 3, 4, 6), 5, 2.0, 3.0
Line = dict[str, Any]


def log_lines(
    scanner: PairedScanner, frames: Sequence[SourceFrame], seed: int, rows: int = 40
) -> tuple[list[FloatArray], FloatArray]:
    """Simulate a log's passage; return line integrals (rows, cells) of each pair and the places (marks, 3) of metal."""
    log = LogModel.with_nails(seed, length_mm=rows * ROW_PITCH_MM)
    [lies] = passages(1, 0.3, np.random.default_rng(seed))
    about = {"rows": rows, "row_pitch_mm": ROW_PITCH_MM, "photons": PHOTONS, "seed": seed}
    passed = simulate_passages(log.slice_at, scanner, frames, [lies], Physics(BEAM, DETECTOR), **about)
    places = np.array([lies.place_of(place) for place in log.metal_places_mm])
    return [lines_of(one)[0] for one in passed], places


@functools.cache
def calibrated(number: int, seed: int) -> tuple[PairedScanner, list[SourceFrame], FoundPairs]:
    """Return a machine, its true frames, and its calibration."""
    rng = np.random.default_rng((seed, number))
    scanner, true = machine(PAIRS[number % len(PAIRS)], rng)
    drawing, made = body(0.0, rng)
    about = {"rows": ROWS, "row_pitch_mm": ROW_PITCH_MM, "photons": PHOTONS, "seed": number}
    passed = simulate_passages(made, scanner, true, passages(2, 0.0, rng), Physics(BEAM, DETECTOR), **about)
    data = [data_of(*each) for each in zip(passed, scanner.pairs, strict=True)]
    return scanner, true, calibrate_pairs(PairsTask(scanner, drawing, data))


def outcome(number: int, seed: int) -> Line:
    """Return what one log gives on a machine that was calibrated."""
    scanner, true, found = calibrated(number // LOGS_EACH, seed)
    stacks, metal = log_lines(scanner, true, number)
    frames = [pair.frame for pair in found.pairs]
    known = np.array([pair.rays.rms_mm for pair in found.pairs]), found.scale_percent_95 / 100.0 / TWO_SIDED_95
    sights = Sights.of(log_pictures(stacks, scanner.pairs, frames, ROW_PITCH_MM), *known)
    rays = PairRays([pair.scanner for pair in scanner.pairs], np.array([*map(to_vector, true)]), found.radius_mm)
    *shift, turn = rigid_motion(rays, np.array([*map(to_vector, frames)]))
    marks = [one.place_mm for one in sights.bodies() if not one.is_ambiguous]
    places = [[*(np.array(rotate(turn, x, y)) + shift), height] for x, y, height in marks]
    off = np.linalg.norm(metal[:, None] - np.array(places).reshape(-1, 3), axis=2)
    moved = to_vector(frames[1]) + np.array([0.0, 0.0, 0.0, MOVED_MM * frames[1].magnification, 0.0])
    frames[1] = SourceFrame.from_vector(moved)
    after = Sights.of(log_pictures(stacks, scanner.pairs, frames, ROW_PITCH_MM), *known)
    before, then = (agreement(each, 1.0) for each in (sights, after))
    return {
        "pairs": len(scanner.pairs),
        "off_mm": off.min(axis=1, initial=np.inf).tolist(),
        "false": int((off.min(axis=0) > NEAR_MM).sum()),
        "states": [before.state, then.state],
        "suspect": then.suspect,
    }


def figures(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the figures of logs on machines with the same number of pairs, or with several."""
    metal = np.array([each for line in lines for each in line["off_mm"]])
    off, (before, then) = metal[metal < NEAR_MM], zip(*(line["states"] for line in lines), strict=True)
    return {
        "logs": len(lines),
        "found_percent": round(100 * off.size / metal.size),
        "within_percent": round(100 * float(np.mean(off < 1.0)), 1),
        "median_mm": round(float(np.median(off)), 2),
        "false": sum(line["false"] for line in lines),
        "alarms": before.count("disagree"),
        "agreed": before.count("agree"),
        "noticed": then.count("disagree"),
        "overlooked": then.count("agree"),
        "named": sum(line["suspect"] == 2 for line in lines),
    }


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/pair_logs.jsonl"))
    parser.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args()
    measurement = Measurement.begin("worker/sawmill_tomography/pairs") if options.write else None
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    with options.out.open("a") as out:
        for number in track(range(len(lines), options.logs), description="logs"):
            lines.append(outcome(number, options.seed) | {"seed": options.seed, "commit": commit()})
            out.write(json.dumps(lines[-1]) + "\n")
            out.flush()
    values = {f"of-{count}": figures([line for line in lines if line["pairs"] == count]) for count in PAIRS}
    values["several"] = figures([line for line in lines if line["pairs"] > 2])
    print(json.dumps(values, indent=2))
    if measurement is not None:
        check_lines(options.out, seed=options.seed)
        measurement.write({"pair-logs": values}, timed=False)


if __name__ == "__main__":
    main()
