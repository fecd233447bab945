"""Long jobs whose process is killed again and again: whether they end as they do when nobody kills them.

    python benchmarks/killed.py [--kills 50] [--seed 1] [--only search|volume] [--shortest 1] [--longest 3]

A published search and a reconstruction by total variation run as a worker runs them, each in a separate process, with
the product's limit of three losses. Attempts get SIGKILL at a random time of `--shortest` to `--longest` seconds after
they were claimed; what is left after the last kill runs to its end. Then the same job runs undisturbed, and theta, or
every value of the volume, is compared bit for bit.
"""

import argparse
import io
import os
import random
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
from job_price import processes

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk, PaperOptions
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionAsk
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.contracts.jobs import Job, JobState
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.program import attempt_starter
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.store import Store
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_vocabulary import CalibrationMethod, DataKind, ReconstructionMethod
from sawmill_worker.program import ATTEMPT_COMMAND

SCANNER, THETA, VIEWS, ROWS = Scanner(859.46, 256, 4.5), Theta(0.9, 710.0, 240.0, 35.0, 0.2), 60, 640
SEARCH = PaperOptions(image_size=128, stop="tight", max_generations=120)


def ingested(store: Store) -> str:
    """Accept a log of rows that look like the phantom with noise; the scan's id."""
    angles = (np.arange(VIEWS) + 0.5) * 2.0 * np.pi / VIEWS
    line = simulate_sinogram(L_SHAPE, FanBeamGeometry(SCANNER, THETA, angles), noise=0.02, seed=1)
    noise = np.random.default_rng(2).standard_normal((VIEWS, ROWS, line.shape[1]))
    buffer = io.BytesIO()
    np.save(buffer, (line[:, None] + 0.02 * line.std() * noise).astype(np.float32))
    scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=ScannerConstants(**vars(SCANNER))))
    spec = ScanSpec(
        scanner_id=scanner.id,
        data=DataKind.LINE_INTEGRALS,
        angles_deg=f"{180 / VIEWS}:{360 / VIEWS}",
        phantom_id="l-shape",
    )
    return store.scans.accept(spec, store.files.receive([buffer.getvalue()], max_bytes=2**30)).id


def attempt_process() -> int | None:
    """Return the process in which an attempt runs: of this program's, the one that began first; the other is spare."""
    began = {}
    for process_id in processes():
        folder = Path(f"/proc/{process_id}")
        try:
            if b"execution.attempt" in (folder / "cmdline").read_bytes():
                began[process_id] = int((folder / "stat").read_text().rpartition(")")[2].split()[19])
        except (FileNotFoundError, ProcessLookupError):
            continue
    return min(began, key=began.__getitem__, default=None)


def kill_again_and_again(
    store: Store, job_id: str, kills: int, between_s: tuple[float, float], rng: random.Random
) -> int:
    """Kill attempts at a job until that is done or there were enough; the number of kills."""
    done, seen = 0, 0
    while done < kills and not (job := store.jobs.get(job_id)).state.ended:
        if job.state is JobState.RUNNING and job.attempt > seen:
            seen = job.attempt
            time.sleep(rng.uniform(*between_s))
            process_id = attempt_process()
            if process_id is not None and not store.jobs.get(job_id).state.ended:
                os.kill(process_id, signal.SIGKILL)
                done += 1
        time.sleep(0.05)
    return done


def run_to_the_end(store: Store, runner: Runner, job_id: str) -> Job:
    """Run what is queued until a job has ended."""
    while not (job := store.jobs.get(job_id)).state.ended:
        if runner.run_next() is None:
            time.sleep(0.05)
    return job


def compare(
    name: str,
    store: Store,
    runner: Runner,
    ask: Callable[[], str],
    tell: Callable[[Job], bytes],
    options: argparse.Namespace,
) -> None:
    """Run one job with kills and one without, and print a line about both."""
    job_id, count = ask(), list[int]()
    rng = random.Random(options.seed)  # noqa: S311 - moments of kills

    def kill() -> None:
        count.append(kill_again_and_again(store, job_id, options.kills, (options.shortest, options.longest), rng))

    killer = threading.Thread(target=kill)
    killer.start()
    started = time.monotonic()
    killed = run_to_the_end(store, runner, job_id)
    killer.join()
    took_s = time.monotonic() - started
    if killed.state is not JobState.SUCCEEDED:
        print(f"{name}: {killed.state.value} after {count[0]} kills: {killed.failure}")
        return
    started = time.monotonic()
    whole = run_to_the_end(store, runner, ask())
    equal = "equal bit for bit" if tell(killed) == tell(whole) else "NOT EQUAL"
    print(
        f"{name}: {count[0]} kills, {killed.attempt} attempts, {killed.losses} losses at the end, {took_s:.0f} s; "
        f"undisturbed {time.monotonic() - started:.0f} s; {equal}"
    )


def main() -> None:
    """Kill both kinds of long jobs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--shortest", type=float, default=1.0)
    parser.add_argument("--longest", type=float, default=3.0)
    parser.add_argument("--only", choices=("search", "volume"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(StorageSettings(data_folder=Path(folder), database_url=None))
        settings = ExecutionSettings(fork_attempts=False, spare_processes=1, loss_wait_s=0, broker_url=None)
        attempts = attempt_starter(ATTEMPT_COMMAND, store, settings)
        runner = Runner(store, settings, threading.Event(), attempts=attempts)
        scan_id = ingested(store)
        run_to_the_end(store, runner, store.scans.get(scan_id).job_id)

        def search() -> str:
            asked = CalibrationAsk(scan_id=scan_id, method=CalibrationMethod.PAPER, paper=SEARCH, rows="0:16")
            return store.calibrations.accept(asked).job_id

        def volume() -> str:
            method = ReconstructionMethod.TOTAL_VARIATION
            asked = ReconstructionAsk(scan_id=scan_id, theta=THETA, method=method, size=128, field_mm=420.0)
            return store.reconstructions.accept(asked).job_id

        def theta_of(job: Job) -> bytes:
            return repr(store.calibrations.get(job.subject_id).theta).encode()

        def values_of(job: Job) -> bytes:
            with h5py.File(store.files.result(job_kinds.RECONSTRUCT, job.subject_id, "volume.h5")) as file:
                return file["entry/reconstruction/data"][()].tobytes()

        if options.only != "volume":
            compare("published search", store, runner, search, theta_of, options)
        if options.only != "search":
            compare(f"volume of {ROWS} slices", store, runner, volume, values_of, options)
        left = list((store.files.folder / "kept").iterdir())
        print(f"left in kept/: {len(left)}")
        runner.close()
        store.close()


if __name__ == "__main__":
    main()
