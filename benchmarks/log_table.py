"""One table: every method on the published log and ten whole logs, time beside error.

Logs: the published one (0) and those of whole_logs.py by the seeds from 4101 (1 to 10), which no rule was tuned on; 12,
20, 45 and 90 views all round, 2 % and 4 % noise; 256 x 256 pixels. All methods get the same data, the same geometry
and the same pixels. Ours choose their settings themselves. The rivals' are chosen with the truth in hand: SIRT's and
CGLS's number of iterations (ASTRA on its CPU projector; SIRT keeps to attenuation of at least 0, CGLS's image is
clipped there), and the weights of total variation, one for a log.

The error is ||image - truth|| / ||truth|| of a row, all pixels, its mean over the judged rows of a log (every 12th:
SIRT takes minutes for a log) and its geometric mean over the logs; beside it that over all rows, where a method made
all. `nail` and `knot` are the contrast of the nail of 8 mm and of the knot of 12 mm along the axis, as a share of the
truth's; `seam` is the largest change of the error from block to block over the largest from row to row elsewhere.
Seconds are of processors and of the clock, for a slice, the settings being chosen; `choosing` is once a log.

Each log, number of views and noise has a file of its own in the output folder: a run adds what is missing there, and
the table shows all that is there. `--again METHOD` measures a method anew.

    python benchmarks/log_table.py [--logs 0-10] [--views 12 20 45 90] [--noise 0.02 0.04] [--methods FBP ...]
                                   [--rows 24] [--size 256] [--out FOLDER] [--again METHOD ...] [--show]
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from log_methods import METHODS, Outcome
from log_scans import PUBLISHED, LogScan, published_scan, whole_scan
from rich.progress import track
from scans import GRID
from whole_logs import ROWS, TABLE_SEED, Rows, WholeLog

from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.warm_up import PARTS, load_iterative_methods

LOGS, VIEWS, NOISES = "0-10", (12, 20, 45, 90), (0.02, 0.04)
Figures = dict[str, Any]


@cache
def whole_log(number: int, rows: int, size: int) -> tuple[WholeLog, Rows]:
    """A log of the table, and its truth."""
    log = WholeLog.random(TABLE_SEED + number, rows=rows)
    return log, log.truth(ImageGrid(size, GRID.field_mm))


def scan_of(number: int, views: int, noise: float, rows: int, size: int) -> LogScan:
    """Of log 0, the published one, or of a whole log."""
    if number == 0:
        return published_scan(views, noise)
    log, truth = whole_log(number, rows, size)
    return whole_scan(log, truth, views, noise, ImageGrid(size, GRID.field_mm))


def figures(scan: LogScan, found: Outcome) -> Figures:
    """What the table shows of a method on a scan."""
    every = list(range(len(scan.truth)))
    judged = found.images if found.judged_only else found.images[scan.judged]
    measured: Figures = {
        "error": scan.error(judged, scan.judged),
        "cpu_s": found.cpu_s,
        "wall_s": found.wall_s,
        "choosing_cpu_s": found.choosing_cpu_s,
        "settings": dict(found.settings),
    }
    if not found.judged_only:
        measured["error_all"] = scan.error(found.images, every)
        measured |= {name: scan.contrast(found.images, name) for name in ("nail", "knot")}
        measured["seam"] = scan.seam(found.images, found.block)
    return measured


def measure(file: Path, scan: Callable[[], LogScan], methods: list[str], again: list[str]) -> None:
    """Add to a file what is missing there."""
    kept: dict[str, Figures] = json.loads(file.read_text()) if file.is_file() else {}
    wanted = [name for name in methods if name not in kept or name in again]
    if not wanted:
        return
    given = scan()
    for name in wanted:
        kept[name] = figures(given, METHODS[name](given))
        file.write_text(json.dumps(kept, indent=1) + "\n")


def rows_of_table(folder: Path) -> Iterator[str]:
    """The table of all files of a folder, the published log apart."""
    settings = defaultdict[tuple[str, int, float], list[dict[str, Figures]]](list)
    for path in sorted(folder.glob("*_*_*.json")):
        log, views, noise = path.stem.split("_")
        settings[published_or_not(log), int(views), float(noise)].append(json.loads(path.read_text()))
    for (logs, views, noise), of_setting in sorted(settings.items()):
        yield f"{logs}, {views} views, {100.0 * noise:g} % noise"
        for name in METHODS:
            found = [kept[name] for kept in of_setting if name in kept]
            if found:
                yield f"  {name:28s}{line(found)}  ({len(found)})"


def published_or_not(log: str) -> str:
    """What the rows of the table are gathered by."""
    return "published log" if log == PUBLISHED else "whole logs"


def line(found: list[Figures]) -> str:
    """Errors, contrasts, seam and seconds of one method over some logs."""
    cells = [geometric_mean(found, "error"), geometric_mean(found, "error_all")]
    cells += [mean(found, "nail"), mean(found, "knot"), mean(found, "seam")]
    text = "".join(f"{'':8s}" if cell is None else f"{cell:8.4f}" for cell in cells[:2])
    text += "".join(f"{'':7s}" if cell is None else f"{cell:7.2f}" for cell in cells[2:])
    seconds = [mean(found, name) or 0.0 for name in ("cpu_s", "wall_s", "choosing_cpu_s")]
    return text + f"{seconds[0]:10.4f}{seconds[1]:9.4f}{seconds[2]:9.2f}"


def mean(found: list[Figures], name: str) -> float | None:
    """Over the logs that have it."""
    values = [one[name] for one in found if one.get(name) is not None]
    return float(np.mean(values)) if values else None


def geometric_mean(found: list[Figures], name: str) -> float | None:
    """Over the logs that have it."""
    values = [one[name] for one in found if one.get(name) is not None]
    return float(np.exp(np.mean(np.log(values)))) if values else None


def numbers(text: str) -> list[int]:
    """0-2 or 5, or several of them: 0-2,5."""
    parts = [part.partition("-") for part in text.split(",")]
    return [number for first, _, last in parts for number in range(int(first), int(last or first) + 1)]


def main(arguments: list[str] | None = None) -> None:
    """Measure what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=numbers, default=numbers(LOGS))
    parser.add_argument("--views", type=int, nargs="+", default=VIEWS)
    parser.add_argument("--noise", type=float, nargs="+", default=NOISES)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--again", nargs="+", choices=METHODS, default=[])
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--size", type=int, default=GRID.size)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/output/log-table"))
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args(arguments)
    asked.out.mkdir(parents=True, exist_ok=True)
    if not asked.show:
        PARTS["slices"]()
        load_iterative_methods()
        work = [(log, views, noise) for log in asked.logs for views in asked.views for noise in asked.noise]
        for log, views, noise in track(work, description="logs"):
            name = PUBLISHED if log == 0 else f"{TABLE_SEED + log}"
            measure(
                asked.out / f"{name}_{views:03d}_{noise:g}.json",
                lambda log=log, views=views, noise=noise: scan_of(log, views, noise, asked.rows, asked.size),
                asked.methods,
                asked.again,
            )
    print(f"{'':30s}{'error':>8s}{'all':>8s}{'nail':>7s}{'knot':>7s}{'seam':>7s}", end="")
    print(f"{'cpu s':>10s}{'wall s':>9s}{'choosing':>9s}  (logs)")
    print("\n".join(rows_of_table(asked.out)))


if __name__ == "__main__":
    main()
