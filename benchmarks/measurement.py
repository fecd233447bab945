"""A measurement for the pages: values in `benchmarks/results/NAME.json`, with the conditions under which they arose.

    python benchmarks/measurement.py

prints the seconds of the reference computation, which tells how fast the machine is at the moment.
"""

import functools
import json
import math
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).with_name("results")
ALLOWED = 1.15
REPEATS = 7


def reference_s() -> float:
    """Measure the reference computation in a separate process, which leaves no threads behind in this one."""
    ended = subprocess.run([sys.executable, __file__], check=True, capture_output=True, text=True)  # noqa: S603 - this file
    return float(ended.stdout)


@functools.cache
def commit() -> str:
    """Name the commit that is checked out, with `-dirty` where files other than pages and results differ from it."""
    changed = _git("status", "--porcelain", "--", ".", ":!docs", ":!benchmarks/results")
    return _git("rev-parse", "--short=12", "HEAD") + ("-dirty" if changed else "")


def keep_published(sources: Mapping[str, str | None], folder: Path = RESULTS) -> None:
    """End the program where results of the published data would be replaced by results of other data.

    `sources` are the data of the new results, by the name of the results file.
    """
    kept = {name: folder / f"{name}.json" for name, source in sources.items() if source != "published"}
    before = {name: json.loads(path.read_text())["values"] for name, path in kept.items() if path.is_file()}
    if lost := [name for name, values in before.items() if values.get("source") == "published"]:
        sys.exit(
            f"Nothing is written: {', '.join(lost)} in {folder} are of the published data. Let SAWMILL_PUBLISHED_DATA "
            "name the folder of these data, and measure again."
        )


def check_lines(path: Path, **settings: object) -> None:
    """End the program where kept lines are not all of these settings and of the commit that is checked out."""
    expected = {"commit": commit(), **settings}
    for line in map(json.loads, path.read_text().splitlines()):
        if (kept := {name: line.get(name) for name in expected}) != expected:
            sys.exit(f"Nothing is written: {path} has results of {kept}, not {expected}. Remove it, and run again.")


@dataclass(frozen=True)
class Measurement:
    """The conditions at the start of a measurement, which writes its values at the end.

    Attributes
    ----------
    conditions : dict
        Command, commit, date, measured folders, machine, cores, and the load before the start.
    reference : callable
        Measures the seconds of the reference computation.
    before_s : float
        Seconds of the reference computation at the start.
    """

    conditions: Mapping[str, Any]
    reference: Callable[[], float]
    before_s: float

    @classmethod
    def begin(cls, *measures: str, reference: Callable[[], float] = reference_s) -> "Measurement":
        """Record the conditions; call it before anything is computed.

        `measures` are the folders of the repository whose changes make the values stale.
        """
        script, *arguments = (one for before, one in pairwise(["", *sys.argv]) if "--out" not in (before, one))
        conditions = {
            "command": shlex.join(["python", os.path.relpath(script, RESULTS.parents[1]), *arguments]),
            "commit": commit(),
            "date": datetime.now(UTC).isoformat(timespec="minutes"),
            "measures": list(measures),
            "machine": _machine(),
            "cores": os.cpu_count(),
            "load": round(os.getloadavg()[0], 2),
        }
        return cls(conditions, reference, reference())

    def write(self, results: Mapping[str, Mapping[str, Any]], folder: Path = RESULTS, *, timed: bool = True) -> None:
        """Write a file for each name, or end the program where the machine's speed changed during it.

        The files are marked `busy` where the machine was slow before and after, by the best time that the folder's
        files of the same machine know. Of results that are no times (`timed` false) the machine's speed is only noted.
        Values whose `source` is the published data are never replaced by values of simulated data.
        """
        keep_published({name: values.get("source") for name, values in results.items()}, folder)
        after_s = self.reference()
        if timed and not 1.0 / ALLOWED <= after_s / self.before_s <= ALLOWED:
            sys.exit(
                f"Nothing is written: the reference computation took {self.before_s:.3f} s before and {after_s:.3f} s "
                f"after, and the two may differ by {ALLOWED - 1.0:.0%}. Measure again on an idle machine."
            )
        best_s = min(self.before_s, after_s, self._known_best_s(folder))
        whole = {
            **self.conditions,
            "reference_s": {"before": self.before_s, "after": after_s, "best": best_s},
            "busy": timed and min(self.before_s, after_s) > ALLOWED * best_s,
        }
        folder.mkdir(parents=True, exist_ok=True)
        for name, values in results.items():
            path = folder / f"{name}.json"
            path.write_text(json.dumps({**whole, "values": values}, indent=2, ensure_ascii=False) + "\n")
            print(f"Written: {path}{', busy' if whole['busy'] else ''}. `make figures` brings it into the pages.")

    def _known_best_s(self, folder: Path) -> float:
        files = [json.loads(path.read_text()) for path in folder.glob("*.json")]
        same = ("machine", "cores")
        return min(
            (
                file["reference_s"]["best"]
                for file in files
                if all(file[name] == self.conditions[name] for name in same)
            ),
            default=math.inf,
        )


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(RESULTS.parents[1]), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603 - our own


def _machine() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.partition(":")[2].strip() for line in lines if "model name" in line), platform.machine())


def _computed_s() -> float:
    """Measure, fastest of some, a Fourier transform on one core and a loop on all of them."""
    import numba  # noqa: PLC0415 - measuring commands import this module for the rest of it
    import numpy as np  # noqa: PLC0415
    import scipy.fft  # noqa: PLC0415

    @numba.njit(parallel=True)
    def smooth(rows: np.ndarray, passes: int) -> None:
        for row in numba.prange(len(rows)):
            line = rows[row]
            for _ in range(passes):
                for column in range(1, len(line) - 1):
                    line[column] = 0.5 * line[column] + 0.25 * (line[column - 1] + line[column + 1])

    laps = []
    for _ in range(REPEATS + 1):
        rows = np.random.default_rng(1).random((1024, 1024))
        started = time.perf_counter()
        for _ in range(4):
            scipy.fft.irfft2(scipy.fft.rfft2(rows))
        smooth(rows, 40)
        laps.append(time.perf_counter() - started)
    return min(laps[1:])


if __name__ == "__main__":
    print(_computed_s())
