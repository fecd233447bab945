"""Measures rows of `guard.py` in one process, by the public Python names alone: any commit can be measured so.

    python benchmarks/guard_rows.py FOLDER

For each row's name on standard input one line of JSON: processor seconds and seconds by the clock, the fastest of the
laps that fit into a third of a second. `FOLDER` holds the scans that `guard.py` simulates.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import sawmill_calibration as sawmill
from sawmill_calibration import Calibration, Scan

LASTING_S, SOURCE_TO_COR_MM = 0.3, 859.46
Row = Callable[[], object]


@cache
def scan(path: Path) -> Scan:
    """Read one of the scans."""
    return sawmill.read_scan(path, data="counts", source_to_cor_mm=SOURCE_TO_COR_MM)


@cache
def calibration(folder: Path) -> Calibration:
    """Calibrate from the phantom's scan."""
    return sawmill.calibrate(scan(folder / "phantom.h5"), "l-shape")


def rows(folder: Path) -> dict[str, Row]:
    """Return the work of each row."""
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


def fastest(row: Row) -> dict[str, float]:
    """Return the least seconds of the processor and by the clock; the first lap prepares and is not counted."""
    row()
    laps, began = [], time.perf_counter()
    while not laps or time.perf_counter() - began < LASTING_S:
        started, used = time.perf_counter(), time.process_time()
        row()
        laps.append((time.process_time() - used, time.perf_counter() - started))
    processor, clock = map(min, zip(*laps, strict=True))
    return {"processor": processor, "clock": clock}


if __name__ == "__main__":
    measured = rows(Path(sys.argv[1]))
    for line in sys.stdin:
        print(json.dumps(fastest(measured[line.rstrip("\n")])), flush=True)
