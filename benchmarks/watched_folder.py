"""A watched folder under kills: whether each of 300 files is in the service once, and in `done/` once.

    python benchmarks/watched_folder.py [--files 300] [--seed 1] [--longest 4]

A real `sawmill serve` and a real `sawmill watch`. A scanner writes small scans: NPY, TIFF and HDF5, some in
two pieces with a pause, some with a `.done` file, every tenth under a name that was used before, every thirtieth no
scan at all. The watcher gets SIGKILL at a random time of at most `--longest` seconds after it has the folder, every
tenth time the service too; both are started again. At the end the scans in the service are compared with what was
written, byte by byte, and so is `done/` with `refused/`. The exit code is 1 unless every count of faults is 0.
"""

import argparse
import contextlib
import hashlib
import io
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import h5py
import httpx
import numpy as np
import tifffile
from faults.servers import free_port

from sawmill_platform.workers.kernel_lock import holder_of
from sawmill_worker.watching.folder import LOCK

VIEWS, CELLS = 12, 16
PITCH_MM = 48.0
# Limit for the remaining files after the last one was written; kills end sooner.
LONGEST_END_S = 600.0


def scan(kind: str, rng: np.random.Generator) -> bytes:
    """Return a unique file, small and readable; or one that is no scan."""
    stack = rng.random((VIEWS, 1, CELLS), dtype=np.float32)
    buffer = io.BytesIO()
    if kind == "npy":
        np.save(buffer, stack)
    elif kind == "tif":
        tifffile.imwrite(buffer, stack, photometric="minisblack")
    elif kind == "h5":
        with h5py.File(buffer, "w") as file:
            file["projections"] = stack
    else:
        buffer.write(b"no scan: " + rng.bytes(200))
    return buffer.getvalue()


class Scanner:
    """Writes files into the folder, as a scanner's software does."""

    def __init__(self, folder: Path, files: int, seed: int) -> None:
        self._folder, self._files = folder, files
        self._rng, self._random = np.random.default_rng(seed), random.Random(seed)  # noqa: S311
        # Files by their digest; two files never have the same bytes.
        self.written: dict[str, str] = {}
        self.bad: set[str] = set()
        self.thread = threading.Thread(target=self._write_all, daemon=True)

    def _write_all(self) -> None:
        for number in range(self._files):
            kind = ("npy", "tif", "h5")[number % 3]
            is_bad = number % 30 == 29
            content = scan("bad" if is_bad else kind, self._rng)
            # A name that was used before, once its file was taken.
            name = f"again.{kind}" if number % 10 == 0 else f"scan-{number}.{kind}"
            while (self._folder / name).exists():
                time.sleep(0.05)
            digest = hashlib.sha256(content).hexdigest()
            self.written[digest] = name
            if is_bad:
                self.bad.add(digest)
            self._write(self._folder / name, content)
            time.sleep(self._random.uniform(0.0, 0.3))

    def _write(self, path: Path, content: bytes) -> None:
        half = len(content) // 2
        with path.open("wb") as file:
            file.write(content[:half])
            file.flush()
            time.sleep(self._random.choice((0.0, 0.0, 0.3)))
            file.write(content[half:])
        if self._random.random() < 0.5:
            path.with_name(f"{path.name}.done").touch()


def described(folder: Path, url: str, scanner_id: str) -> str:
    """Describe the folder in TOML."""
    return f"""\
service = "{url}"
poll_s = 0.2

[[folders]]
folder = "{folder}"
scanner_id = "{scanner_id}"
still_for_s = 1

[[folders.files]]
match = "*"
data = "line-integrals"
angles_deg = "0:30"
"""


class Processes:
    """The service and the watcher, which are started again after each kill."""

    def __init__(self, place: Path) -> None:
        self._log = (place / "log").open("ab")
        self._environment = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        self._environment |= {"SAWMILL_LEASE_S": "4", "SAWMILL_HEARTBEAT_S": "1", "SAWMILL_MAX_ATTEMPTS": "10"}
        self._data, self._settings = place / "data", place / "watch.toml"
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.service = self._start_service()
        self.watcher: subprocess.Popen[bytes] | None = None

    def start_watcher(self, lock: Path) -> None:
        """Start the watcher, and wait until it has locked the folder."""
        self.watcher = self._start("watch", str(self._settings))
        while holder_of(lock) != str(self.watcher.pid):
            if self.watcher.poll() is not None:
                raise SystemExit(f"the watcher ended by itself with {self.watcher.returncode}")
            time.sleep(0.01)

    def kill_watcher(self) -> None:
        """Kill the watcher by SIGKILL; one that has ended by itself is a fault."""
        assert self.watcher is not None
        if (code := self.watcher.poll()) is not None:
            raise SystemExit(f"the watcher ended by itself with {code}")
        self.watcher.kill()
        self.watcher.wait()

    def kill_service(self) -> None:
        """Kill the service by SIGKILL, and start it again."""
        self.service.kill()
        self.service.wait()
        self.service = self._start_service()

    def end(self) -> None:
        """End the processes in order."""
        for process in filter(None, (self.watcher, self.service)):
            process.terminate()
            process.wait(60)

    def ask(self, path: str, **query: str) -> Any:  # noqa: ANN401 - JSON
        """Request a path until the service answers."""
        while True:
            with contextlib.suppress(httpx.TransportError):
                return (
                    httpx.get(f"{self.url}{path}", params=query, trust_env=False, timeout=60).raise_for_status().json()
                )
            time.sleep(0.2)

    def _start_service(self) -> "subprocess.Popen[bytes]":
        return self._start("serve", "--data", str(self._data), "--port", str(self.port), "--no-examples")

    def _start(self, *words: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "sawmill_command.commands", *words]
        return subprocess.Popen(command, env=self._environment, stdout=self._log, stderr=self._log)  # noqa: S603


def ended(folder: Path) -> Counter[str]:
    """Count the files by digest, without the notes next to the files."""
    files = (path for path in folder.glob("*/*") if not path.name.endswith((".json", ".reason.txt")))
    return Counter(hashlib.sha256(path.read_bytes()).hexdigest() for path in files)


def scans(processes: Processes, scanner_id: str) -> Counter[tuple[str, str]]:
    """Count the scans of the service by digest and state."""
    found: Counter[tuple[str, str]] = Counter()
    query = {"scanner_id": scanner_id, "limit": "100"}
    while True:
        page = processes.ask("/v1/scans", **query)
        found.update((each["sha256"], each["state"]) for each in page["items"])
        if page["next"] is None:
            return found
        query["after"] = page["next"]


def run(place: Path, files: int, seed: int, longest_s: float) -> dict[str, int]:
    """Run the study; return counts of kills and of faults."""
    folder, chance = place / "scanner", random.Random(seed)  # noqa: S311
    folder.mkdir()
    processes = Processes(place)
    processes.ask("/health/ready")
    constants = {"source_to_cor_mm": 859.46, "num_detector_pixels": CELLS, "detector_pitch_mm": PITCH_MM}
    made = httpx.post(f"{processes.url}/v1/scanners", json={"name": "line", "constants": constants}, trust_env=False)
    scanner_id = made.raise_for_status().json()["id"]
    (place / "watch.toml").write_text(described(folder, processes.url, scanner_id))
    scanner = Scanner(folder, files, seed)
    scanner.thread.start()
    kills = service_kills = 0
    until_s = None
    while scanner.thread.is_alive() or any(folder.glob("taken/*.json")) or any(map(Path.is_file, folder.iterdir())):
        if not scanner.thread.is_alive():
            until_s = until_s or time.monotonic() + LONGEST_END_S
            if time.monotonic() > until_s:
                break
        processes.start_watcher(folder / "taken" / LOCK)
        time.sleep(chance.uniform(0.0, longest_s))
        processes.kill_watcher()
        kills += 1
        if kills % 10 == 0:
            processes.kill_service()
            service_kills += 1
    there, done, refused = scans(processes, scanner_id), ended(folder / "done"), ended(folder / "refused")
    processes.end()
    good = scanner.written.keys() - scanner.bad
    return {
        "files": len(scanner.written),
        "kills of the watcher": kills,
        "kills of the service": service_kills,
        "good files that are no scan, once": sum(there[digest, "ready"] != 1 for digest in good),
        "files that are no scan and are not refused, once": sum(there[bad, "refused"] != 1 for bad in scanner.bad),
        "scans that nobody wrote": sum(digest not in scanner.written for digest, _ in there),
        "good files that are not in done/, once": sum(done[digest] != 1 for digest in good),
        "bad files that are not in refused/, once": sum(refused[digest] != 1 for digest in scanner.bad),
        "other files in done/ and refused/": len((done.keys() - good) | (refused.keys() - scanner.bad)),
        "files that are left": sum(path.is_file() for path in folder.iterdir()),
    }


def main() -> None:
    """Run it and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1, help="of what is written, and when it is killed")
    parser.add_argument("--longest", type=float, default=4.0, help="seconds between two kills at most")
    options = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as place:
        counts = run(Path(place), options.files, options.seed, options.longest)
    for what, number in counts.items():
        print(f"{number:6}  {what}")
    print(f"{time.monotonic() - started:6.0f}  seconds")
    faults = list(counts.values())[3:]
    sys.exit(1 if any(faults) else 0)


if __name__ == "__main__":
    main()
