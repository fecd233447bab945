"""A mill's physics against the calibration: the true error and its bound, the verdict, and the named causes.

    python benchmarks/mill.py [--scans 5400] [--seed 1] [--jobs 2] [--out build/mill.jsonl] [--only EFFECT|clean|pair]
        [--write]
    python benchmarks/mill.py --table build/mill.jsonl

Scans in counts with ten flats from the simulator of physics, which shares nothing with the calibration's model: of
four scans one is clean, two have one effect (`mill_scans.EFFECTS`, each in its turn), one has a pair. Scan n depends on
n and the seed alone. Results are appended to a file of JSON lines; an interrupted study continues where it stopped.
`--write` writes `benchmarks/results/mill.json`, if all lines are of its seed and of the commit that is checked out.

The columns: `effect`, the median ray error of the plain fit without remedies on noise-free data; median true ray error
and bound (`upper_95`), mm, up to a common scale; the share in which the bound holds, a star where 95 % are refuted at
1 % (one-sided binomial test); verdicts; wrong passes of the rays (above 0.1 mm, or a wrong hypothesis) and the 95 %
upper limit of their share of all passes; the share passed of scans whose true error is below 0.05 mm; for one effect
above 0.05 mm the share in which it is named alone or among three causes, for clean scans the share that names none;
median true error and bound of the scale, %, and how often that bound holds; median seconds of one calibration in one
thread; refusals and crashes.
"""

import argparse
import json
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numba
import numpy as np
from measurement import Measurement, check_lines, commit
from mill_scans import EFFECTS, LOG_RADIUS_MM, StudyScan
from mill_table import read, summary, table
from rich.progress import track
from scanners import SCANNER

from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.errors import CalibrationError
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.physics import Physics

SCANS = 5400
LOG_LEAST = 1e-6


def outcome(number: int, seed: int) -> dict[str, Any]:
    """Return the outcome of one scan, as JSON has it."""
    scan = StudyScan.of(number, seed)
    setting = scan.setting
    about = {
        "number": number,
        "kind": scan.kind,
        "sizes": scan.sizes,
        "physics": _given(asdict(scan.physics)),
        "phantom": setting.drawing.name,
        "views": setting.angles_rad.size,
        "photons": round(setting.photons),
        "attenuation_per_mm": round(setting.attenuation_per_mm, 5),
        "hypothesis": [setting.handedness, setting.rotation],
        "effect_mm": effect_mm(scan) if scan.kind == "single" else None,
    }
    task = scan.task()
    started = time.perf_counter()
    try:
        found = calibrate(task, seed=number)
    except CalibrationError as error:
        return about | {"refused": error.code}
    except Exception as error:  # noqa: BLE001 - a column of the table
        return about | {"crashed": f"{type(error).__name__}: {error}"}
    return about | _answer(scan, found) | {"seconds": round(time.perf_counter() - started, 4)}


def _answer(scan: StudyScan, found: CalibrationOutcome) -> dict[str, Any]:
    assert found.findings.error_bars is not None
    setting = scan.setting
    true = ray_error(SCANNER, setting.frame, found.frame, radius_mm=LOG_RADIUS_MM, other_scanner=found.scanner)
    return {
        "error_mm": true.rms_mm,
        "upper_95_mm": found.findings.error_bars.predicted_ray_error.upper_95_mm,
        "rms_mm": found.findings.error_bars.predicted_ray_error.rms_mm,
        "right_hypothesis": (found.handedness, found.rotation) == (setting.handedness, setting.rotation),
        "scale_error_percent": 100.0 * true.scale_change,
        "scale_uncertainty_percent": found.findings.scale.percent_95,
        "verdict": found.judgement.verdict,
        "rays_verdict": found.judgement.rays_verdict,
        "adjustments": [*scan.remarks, *found.adjustments],
        "reasons": list(found.judgement.reasons),
    }


def _given(physics: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Select the effects that are not zero."""
    return {group: {name: value for name, value in of.items() if value} for group, of in physics.items()}


def effect_mm(scan: StudyScan) -> float | None:
    """Compute the ray error between plain fits with and without the effect, on noise-free data; None without a fit."""
    try:
        with_it, without = (_plain(scan, physics) for physics in (scan.physics, scan.ideal))
    except CalibrationError:
        return None
    return ray_error(
        SCANNER, without.frame, with_it.frame, radius_mm=LOG_RADIUS_MM, other_scanner=with_it.scanner
    ).rms_mm


def _plain(scan: StudyScan, physics: Physics) -> CalibrationOutcome:
    """Calibrate without remedies, the hypothesis given."""
    setting = scan.setting
    lines = -np.log(scan.scanned(physics).signal.clip(LOG_LEAST))
    task = CalibrationTask(
        SCANNER,
        setting.drawing,
        lines,
        setting.angles_rad,
        handedness=setting.handedness,
        rotation=setting.rotation,
        without=frozenset(Adjustment),
    )
    return calibrate(task)


def wanted(numbers: range, only: str | None, seed: int) -> Iterator[int]:
    """Yield the scans of a kind or an effect; all by default."""
    for number in numbers:
        place = ("clean", "single", "single", "pair")[number % 4]
        if only is None or only == place or (place == "single" and only in StudyScan.of(number, seed).sizes):
            yield number


def main(arguments: list[str] | None = None) -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=SCANS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("build/mill.jsonl"))
    parser.add_argument("--only", choices=("clean", "single", "pair", *EFFECTS))
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--table", type=Path, metavar="RESULTS", help="only print the table of these results")
    way.add_argument("--write", action="store_true", help="write the figures of the pages")
    options = parser.parse_args(arguments)
    measurement = Measurement.begin("worker/sawmill_tomography/calibration") if options.write else None
    if options.table is None:
        run(options)
    outcomes = read(options.table or options.out)
    print(table(outcomes))
    if measurement is not None:
        check_lines(options.out, seed=options.seed)
        measurement.write({"mill": summary(outcomes)}, timed=False)


def run(options: argparse.Namespace) -> None:
    """Append what the results file does not have yet."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.touch()
    written = options.out.read_bytes()
    options.out.write_bytes(written[: written.rfind(b"\n") + 1])  # without a line that was interrupted
    done = {one.number for one in read(options.out)}
    left = [n for n in wanted(range(options.scans), options.only, options.seed) if n not in done]
    with (
        options.out.open("a") as file,
        ProcessPoolExecutor(options.jobs, initializer=numba.set_num_threads, initargs=(1,)) as pool,
    ):
        running = [pool.submit(outcome, number, options.seed) for number in left]
        for one in track(as_completed(running), total=len(running), description="scans"):
            file.write(json.dumps(one.result() | {"commit": commit(), "seed": options.seed}) + "\n")
            file.flush()


if __name__ == "__main__":
    main()
