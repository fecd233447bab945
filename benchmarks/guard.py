"""Is this commit slower or less exact than its parent? Red where a row is so by a quarter, twice in a row.

    python benchmarks/guard.py [--against COMMIT]

The other commit is checked out in `build/guard`, with this environment, or a separate one where its dependencies
differ. Both are measured in turns, five times, on the same scans: calibration, FBP, total variation and a drift check
in one warm process of each commit, starts of the command line, and a short job of a service at rest. A row is slower
where the least of five processor seconds, or of five times by the clock, is.

The rows of the pages' claims have an error next to the seconds: the published scan from 360 and from 20 views (without
its data, a scan that ASTRA projects from a pixel image), and `examples/bad-day.json`. It is the RMS ray error up to one
rotation, the scale included. Each of the five times has another seed. A row is less exact where the median grows by a
quarter and by more than the noise, which is the seeds' median distance from their median.

Rows that are slower or less exact are measured again. Exit code 1 where one stays so. A quarter of an hour on two
cores, on which little else should run.
"""

import argparse
import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import guard_rows
import httpx
import numpy as np
from job_price import VIEWS, calibrated, scan_of
from scanners import SCANNER
from scans import TRUE_THETA, rotated_ray_error_mm, sources

from sawmill_tomography.geometry.geometry import Theta, to_vector
from sawmill_vocabulary import DetectorModule

ROOT = Path(__file__).resolve().parents[1]
CHECKOUTS = ROOT / "build" / "guard"
ROUNDS, ALLOWED, READY_S = 5, 1.25, 120.0
THETA = ",".join(map(str, to_vector(TRUE_THETA)))
# The scans: BODY and options of `sawmill simulate`.
SCANS = {
    "phantom.h5": ("l-shape", "--views", "360"),
    "log.h5": ("log", "--views", "360", "--rows", "64"),
    "few-views.h5": ("log", "--views", "20", "--rows", "16"),
    "bad-day.h5": ("l-shape", "--views", "90", "--physics", str(ROOT / "examples/bad-day.json")),
}

KINDS = ("processor", "clock")

# Lap by KINDS, and `error_mm` of the rows that have one.
Lap = dict[str, float]
Measure = Callable[[], Lap]


@dataclass(frozen=True)
class Tree:
    """A checkout and the environment that it runs in."""

    folder: Path
    python: Path

    @property
    def environment(self) -> dict[str, str]:
        """Ours, with this checkout's code and no settings of a service."""
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        return {**kept, "PYTHONPATH": f"{self.folder / 'service'}:{self.folder / 'worker'}"}

    @property
    def project(self) -> dict[str, Any]:
        """The project's table in pyproject.toml."""
        return tomllib.loads((self.folder / "pyproject.toml").read_text())["project"]

    @property
    def dependencies(self) -> tuple[list[str], str]:
        """The specification of an environment: dependencies and pinned versions."""
        return self.project["dependencies"], (self.folder / "constraints.txt").read_text()

    def command(self, *arguments: str) -> list[str]:
        """Return the command line of the program `sawmill` of this checkout."""
        module, _, function = self.project["scripts"]["sawmill"].partition(":")
        return [str(self.python), "-c", f"from {module} import {function}; {function}()", *arguments]

    def run(self, *arguments: str) -> None:
        """Run the program to its end."""
        subprocess.run(self.command(*arguments), check=True, capture_output=True, env=self.environment)  # noqa: S603 - our own

    def started(self, *arguments: str) -> Lap:
        """Measure the program as a process, start included."""
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        self.run(*arguments)
        clock, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        return {"processor": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, "clock": clock}


THIS = Tree(ROOT, Path(sys.executable))


def checked_out(commit: str) -> Tree:
    """Check out another commit and compile its kernels; remove the folders of earlier runs."""
    revision = _git("rev-parse", "--verify", f"{commit}^{{commit}}")
    folder = CHECKOUTS / revision[:12]
    for other in CHECKOUTS.glob("*"):
        if other != folder:
            _git("worktree", "remove", "--force", str(other))
    if not folder.is_dir():
        _git("worktree", "prune")
        _git("worktree", "add", "--detach", str(folder), revision)
    tree = Tree(folder, THIS.python)
    if tree.dependencies == THIS.dependencies:
        return tree
    subprocess.run(["make", "install"], cwd=folder, check=True)  # noqa: S607 - as its README says
    return Tree(folder, folder / ".venv" / "bin" / "python")


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()  # noqa: S603 - our own


@contextmanager
def warm_process(tree: Tree, scans: Path) -> Iterator[Callable[[str], Lap]]:
    """Start a process that measures rows by their names."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([tree.python, guard_rows.__file__, scans], env=tree.environment, **pipes) as process:  # noqa: S603 - ours

        def measured(row: str) -> Lap:
            process.stdin.write(row + "\n")
            process.stdin.flush()
            lap = json.loads(process.stdout.readline())
            return lap | {"error_mm": error_mm(lap.pop("theta"), lap.pop("modules"))} if "theta" in lap else lap

        yield measured
        process.stdin.close()


def error_mm(theta: list[float], modules: list[dict[str, Any]]) -> float:
    """Return the ray error, scale included, of a geometry that was found with these modules of the detector."""
    scanner = replace(SCANNER, detector_modules=tuple(DetectorModule(**module) for module in modules))
    return rotated_ray_error_mm(Theta(*theta).source_frame(SCANNER.source_to_cor_mm), scanner)


@contextmanager
def short_job(tree: Tree, folder: Path) -> Iterator[Measure]:
    """Measure a service at rest, and its cost of a calibration of 20 views."""
    folder.mkdir()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = tree.command("serve", "--data", str(folder / "data"), "--port", str(port), "--no-examples")
    with (folder / "log").open("wb") as log:
        service = subprocess.Popen(command, stdout=log, stderr=log, env=tree.environment)  # noqa: S603 - our own
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client:
                _wait_until_ready(client, folder / "log")
                scan_id = scan_of(client, folder, VIEWS)

                def measured() -> Lap:
                    processor, clock = calibrated(client, scan_id, service.pid)
                    return {"processor": processor, "clock": clock}

                measured()
                yield measured
        finally:
            service.terminate()
            service.wait()


def _wait_until_ready(client: httpx.Client, log: Path) -> None:
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        try:
            if client.get("/health/ready").is_success:
                return
        except httpx.TransportError:  # not listening yet
            pass
        time.sleep(0.1)
    sys.exit(f"The service was not ready within {READY_S:.0f} s:\n{log.read_text()}")


def rows_of(tree: Tree, folder: Path, scans: Path, resources: ExitStack) -> dict[str, Measure]:
    """Measure every row of one checkout."""
    tree.run("compile")
    in_process = resources.enter_context(warm_process(tree, scans))
    phantom = (str(scans / "phantom.h5"), "--data", "counts", "--source-to-cor-mm", str(guard_rows.SOURCE_TO_COR_MM))
    calibrate = ("calibrate", *phantom, "--phantom", "l-shape", "--json")
    return {
        **{row: partial(in_process, row) for row in guard_rows.rows(scans) | guard_rows.seeded_rows(scans)},
        "sawmill --help": partial(tree.started, "--help"),
        "sawmill calibrate, 360 views": partial(tree.started, *calibrate),
        "short job": resources.enter_context(short_job(tree, folder)),
    }


def suspects(here: Mapping[str, Measure], other: Mapping[str, Measure]) -> list[str]:
    """Measure all rows in turns, five times; the names of those that are slower or less exact here. Prints all."""
    laps: dict[str, list[tuple[Lap, Lap]]] = {row: [] for row in here}
    for _ in range(ROUNDS):
        for row, measured in laps.items():
            measured.append((other[row](), here[row]()))
    found = []
    for row, measured in laps.items():
        before, now = zip(*measured, strict=True)
        seconds = [{kind: min(lap[kind] for lap in side) for kind in KINDS} for side in (before, now)]
        errors = [[lap["error_mm"] for lap in side if "error_mm" in lap] for side in (before, now)]
        ratio = max(seconds[1][kind] / seconds[0][kind] for kind in KINDS)
        texts = [" / ".join(f"{side[kind]:.4f}" for kind in KINDS) for side in seconds]
        shown = f"  error, mm {median(errors[0]):.4f} now {median(errors[1]):.4f}" if errors[1] else ""
        print(f"{row:30} {texts[0]:18} now {texts[1]:18} {ratio:.2f}{shown}", flush=True)
        if ratio > ALLOWED or (errors[1] and less_exact(*errors)):
            found.append(row)
    return found


def less_exact(before: list[float], now: list[float]) -> bool:
    """Return True if the median error is larger by a quarter and by more than the noise of the seeds."""
    noise = max(median(abs(error - median(errors)) for error in errors) for errors in (before, now))
    return median(now) > max(ALLOWED * median(before), median(before) + noise)


def red(here: Mapping[str, Measure], other: Mapping[str, Measure]) -> list[str]:
    """Select the rows that are slower or less exact twice in a row."""
    again = suspects(here, other)
    return suspects({row: here[row] for row in again}, other) if again else []


def main() -> None:
    """Print the table; exit code 1 where a row is red."""
    from published_pipeline import claimed_scan  # noqa: PLC0415 - ODL is slow to import

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", default="HEAD^", metavar="COMMIT", help="the commit before this one by default")
    options = parser.parse_args()
    print(f"load before the start {os.getloadavg()[0]:.2f}; seconds of the processor / by the clock", flush=True)
    print(f"the published scan is {sources()[0]}", flush=True)
    here, other = THIS, checked_out(options.against)
    with tempfile.TemporaryDirectory(prefix="sawmill-guard-") as name, ExitStack() as resources:
        folder = Path(name)
        for file, (body, *given) in SCANS.items():
            here.run("simulate", body, "--theta", THETA, "--output", str(folder / file), *given)
        np.save(folder / "published.npy", claimed_scan())
        before = rows_of(other, folder / "before", folder, resources)
        now = rows_of(here, folder / "now", folder, resources)
        found = red(now, before)
    print("\n".join([f"{options.against} is {other.folder.name}.", *(f"red: {row}" for row in found)]))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
