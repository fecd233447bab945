"""Table of every method on the published log and ten whole logs, with time and error.

Logs: the published one (0) and logs of whole_logs.py by the seeds from 4101 (1 to 10), which no rule was tuned on; 12,
20, 45 and 90 views all round at 2 % noise, and 20 views at 4 %; 256 x 256 pixels, 16 rows (the published log is one
row). All methods get the same data, the same geometry and the same pixels. Ours choose their settings themselves. The
rivals' are chosen with the truth in hand: SIRT's and CGLS's number of iterations (ASTRA on its CPU projector; SIRT
keeps to attenuation of at least 0, CGLS's image is clipped there), and the weights of total variation, one for a log.
The truth of the published log is published with it.

The error is ||image - truth|| / ||truth|| of the middle row of a log, all pixels, and its geometric mean over the logs:
SIRT takes up to a minute for a row. A second table has the mean of all rows, if made. `nail` and `knot` are the
contrast of the nail of 8 mm and of the knot of 12 mm along the axis, as a share of the truth's. Seconds are for a
slice, the settings being chosen, with one thread: processor seconds, which other work on the machine changes little,
and clock seconds. `choosing` is processor seconds once a log, where the data choose.

Each log, number of views and noise has a separate file in the output folder: a run adds what is missing there, and
the table shows all that is there. `--again METHOD` measures a method again, `--seconds METHOD` its seconds alone, with
the settings that are kept. Two runs may share a folder as long as their logs or settings differ.

    python benchmarks/log_table.py [--logs 0-10] [--settings 12:0.02 20:0.04 ...] [--methods FBP ...]
                                   [--rows 16] [--size 256] [--out FOLDER] [--again METHOD ...]
                                   [--seconds METHOD ...] [--show]
"""

import argparse
import json
from collections.abc import Iterator
from functools import cache, partial
from itertools import product
from pathlib import Path

import numba
from log_methods import METHODS, Outcome
from log_scans import PUBLISHED, LogScan, published_scan, whole_scan
from log_table_text import Figures, tables
from rich.progress import Progress
from scans import GRID
from whole_logs import TABLE_SEED, Rows, WholeLog

from sawmill_platform.files.whole_files import whole_file
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.warm_up import PARTS, load_iterative_methods

LOGS, ROWS = "0-10", 16
# Views all round, and noise relative to the RMS of a row.
SETTINGS = ((12, 0.02), (20, 0.02), (20, 0.04), (45, 0.02), (90, 0.02))


@cache
def whole_log(number: int, rows: int, size: int) -> tuple[WholeLog, Rows]:
    """Return a log of the table, and its truth."""
    log = WholeLog.random(TABLE_SEED + number, rows=rows)
    return log, log.truth(ImageGrid(size, GRID.field_mm))


def scan_of(number: int, views: int, noise: float, rows: int, size: int) -> LogScan:
    """Return the scan of log 0, the published one, or of a whole log."""
    if number == 0:
        return published_scan(views, noise)
    log, truth = whole_log(number, rows, size)
    return whole_scan(log, truth, views, noise, ImageGrid(size, GRID.field_mm))


def figures(scan: LogScan, found: Outcome) -> Figures:
    """Return the figures that are kept of a method on a scan."""
    every, judged = list(range(len(scan.truth))), scan.judged
    measured: Figures = {
        "error": scan.error(found.images if found.judged_only else found.images[judged], judged),
        "choosing_cpu_s": found.choosing_cpu_s,
        "settings": dict(found.settings),
        **seconds(found),
    }
    if not found.judged_only:
        measured["errors"] = scan.errors(found.images, every)
        measured |= {name: scan.contrast(found.images, name) for name in ("nail", "knot")}
    return measured


def seconds(found: Outcome) -> Figures:
    """Return the seconds of a slice, by the processor and by the clock."""
    return {"cpu_s": found.cpu_s, "wall_s": found.wall_s}


class Cell:
    """The figures of a log, a number of views and a noise, kept in a file; the scan is made when it is needed."""

    def __init__(self, asked: argparse.Namespace, log: int, views: int, noise: float) -> None:
        self.name = PUBLISHED if log == 0 else f"{TABLE_SEED + log}"
        self._file: Path = asked.out / f"{self.name}_{views:03d}_{noise:g}.json"
        self._scan = cache(partial(scan_of, log, views, noise, asked.rows, asked.size))
        self._kept: dict[str, Figures] = json.loads(self._file.read_text()) if self._file.is_file() else {}

    def measure(self, method: str, *, again: bool) -> None:
        """Measure the table's figures of a method, unless they are kept."""
        if again or method not in self._kept:
            self._keep(method, figures(self._scan(), METHODS[method](self._scan(), None)))

    def measure_seconds(self, method: str) -> None:
        """Measure the seconds with the kept settings; do nothing where none are kept."""
        if method in self._kept:
            found = METHODS[method](self._scan(), self._kept[method]["settings"])
            self._keep(method, self._kept[method] | seconds(found))

    def _keep(self, method: str, measured: Figures) -> None:
        self._kept[method] = measured
        with whole_file(self._file) as file:
            file.write((json.dumps(self._kept, indent=1) + "\n").encode())


def work(asked: argparse.Namespace) -> Iterator[str]:
    """Measure what is missing; before each step, what it is."""
    for log, (views, noise) in product(asked.logs, asked.settings):
        cell = Cell(asked, log, views, noise)
        for method in asked.seconds or asked.methods:
            yield f"{cell.name}, {views} views, {100.0 * noise:g} % noise: {method}"
            if asked.seconds:
                cell.measure_seconds(method)
            else:
                cell.measure(method, again=method in asked.again)


def numbers(text: str) -> list[int]:
    """Parse numbers: 0-2 or 5, or several of them: 0-2,5."""
    parts = [part.partition("-") for part in text.split(",")]
    return [number for first, _, last in parts for number in range(int(first), int(last or first) + 1)]


def setting(text: str) -> tuple[int, float]:
    """Parse views and noise, such as 20:0.04."""
    views, _, noise = text.partition(":")
    return int(views), float(noise)


def main(arguments: list[str] | None = None) -> None:
    """Measure what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=numbers, default=numbers(LOGS))
    parser.add_argument("--settings", type=setting, nargs="+", default=SETTINGS)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--again", nargs="+", choices=METHODS, default=[])
    parser.add_argument("--seconds", nargs="+", choices=METHODS, default=[])
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--size", type=int, default=GRID.size)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/output/log-table"))
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args(arguments)
    asked.out.mkdir(parents=True, exist_ok=True)
    if not asked.show:
        numba.set_num_threads(1)
        PARTS["slices"]()
        load_iterative_methods()
        steps = len(asked.logs) * len(asked.settings) * len(asked.seconds or asked.methods)
        with Progress() as progress:
            bar = progress.add_task("", total=steps)
            for done, step in enumerate(work(asked)):
                progress.update(bar, description=step, completed=done)
            progress.update(bar, completed=steps)
    print("\n".join(tables(asked.out)))


if __name__ == "__main__":
    main()
