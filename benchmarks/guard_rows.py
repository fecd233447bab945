"""Measures rows of `guard.py` in one process, by the public Python names alone: any commit can be measured so.

    python benchmarks/guard_rows.py FOLDER

For each row's name on standard input one line of JSON: processor seconds and seconds by the clock, the least of the
laps that fit into a third of a second. A row whose error counts adds theta and the modules of the detector that its
calibration found; each time it takes the next seed of the search. `FOLDER` holds the scans that `guard.py` makes.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import sawmill_calibration as sawmill
from sawmill_calibration import Calibration, Scan

LASTING_S, SOURCE_TO_COR_MM, PITCH_MM = 0.3, 859.46, 1.502864583
Row = Callable[[], object]
Seeded = Callable[[int], Calibration]


@cache
def scan(path: Path) -> Scan:
    """Read one of the scans."""
    lines: dict[str, Any] = {"data": "line-integrals", "angles_deg": "0.5:1", "detector_pitch_mm": PITCH_MM}
    kind = lines if path.suffix == ".npy" else {"data": "counts"}
    return sawmill.read_scan(path, source_to_cor_mm=SOURCE_TO_COR_MM, **kind)


@cache
def calibration(folder: Path) -> Calibration:
    """Calibrate from the phantom's scan."""
    return sawmill.calibrate(scan(folder / "phantom.h5"), "l-shape")


def rows(folder: Path) -> dict[str, Row]:
    """Return the work of each row whose time counts."""
    phantom, log, few = (folder / name for name in ("phantom.h5", "log.h5", "few-views.h5"))
    return {
        "calibration, 360 views": lambda: sawmill.calibrate(scan(phantom), "l-shape"),
        "calibration, 20 views": lambda: sawmill.calibrate(scan(phantom), "l-shape", views=20),
        "FBP, 64 slices": lambda: sawmill.reconstruct(scan(log), calibration(folder), method="fbp"),
        "total variation, 16 slices": lambda: sawmill.reconstruct(
            scan(few), calibration(folder), method="total_variation", weight=300.0, coupling=0.5
        ),
        "drift check, 120 views": lambda: sawmill.drift(scan(log).select(views=120), calibration(folder)),
    }


def seeded_rows(folder: Path) -> dict[str, Seeded]:
    """Return the calibration, by its seed, of each row whose time and error count."""
    published, bad_day = folder / "published.npy", folder / "bad-day.h5"
    return {
        "published scan, 360 views": lambda seed: sawmill.calibrate(scan(published), "l-shape", seed=seed),
        "published scan, 20 views": lambda seed: sawmill.calibrate(scan(published), "l-shape", views=20, seed=seed),
        "bad day, 90 views": lambda seed: sawmill.calibrate(scan(bad_day), "l-shape", seed=seed),
    }


def least(row: Row) -> dict[str, float]:
    """Return the least seconds of the processor and by the clock."""
    laps, began = [], time.perf_counter()
    while not laps or time.perf_counter() - began < LASTING_S:
        started, used = time.perf_counter(), time.process_time()
        row()
        laps.append((time.process_time() - used, time.perf_counter() - started))
    processor, clock = map(min, zip(*laps, strict=True))
    return {"processor": processor, "clock": clock}


def with_geometry(row: Seeded, seed: int) -> dict[str, Any]:
    """Return the seconds of one calibration, and the geometry that it found."""
    answers: list[Calibration] = []
    seconds = least(lambda: answers.append(row(seed)))
    modules = [vars(module) for module in answers[0].scanner.detector_modules]
    return {**seconds, "theta": list(vars(answers[0].theta).values()), "modules": modules}


if __name__ == "__main__":
    timed, seeded = rows(Path(sys.argv[1])), seeded_rows(Path(sys.argv[1]))
    seeds = {name: count() for name in seeded}
    for line in sys.stdin:
        name = line.rstrip("\n")
        lap = with_geometry(seeded[name], next(seeds[name])) if name in seeded else least(timed[name])
        print(json.dumps(lap), flush=True)
