"""The price of a short job: processor seconds a calibration, and the memory of a service at rest.

    python benchmarks/job_price.py [--jobs 10] [--against TREE]

`sawmill serve` runs as users start it, with its own workers and an empty data folder. Short jobs are calibrations of a
small scan of 20 views, requested one after another over HTTP. The system's own books are read (/proc): the
proportional set size of all processes of the service, and their processor seconds, ended children included.
What the service at rest spends in the same time is subtracted. Memory is measured after a job, and once a worker that
had none for long (`SAWMILL_SPARE_IDLE_S`) has ended what it keeps ready. Jobs a second are measured on a queue of forty
and two workers, from the first one's start to the last one's end. `--against` measures another checkout of this
repository too, after this one. The figures of this one go to `benchmarks/results/job-price.json`.
"""

import argparse
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from datetime import datetime
from pathlib import Path

import httpx
from measurement import Measurement

from sawmill_command import demo_client, examples
from sawmill_command.demo_client import Json

HERE = Path(__file__).resolve().parents[1]
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
VIEWS, REST_S, QUIET_S, QUEUED = 20, 10.0, 1.5, 40


def scan_of(client: httpx.Client, folder: Path, views: int) -> str:
    """Create a scanner, and a stack of it with the phantom on a log's end, read and ready; return the scan's id."""
    stack = folder / "stack.h5"
    examples.write_mill_stack(stack, views, examples.mill_slices())
    # An earlier version, with which the guard compares, knows only these fields.
    names = ("source_to_cor_mm", "num_detector_pixels", "detector_pitch_mm")
    spec = {"name": "line", "constants": {name: getattr(examples.SCANNER, name) for name in names}}
    scanner = demo_client.post(client, "/v1/scanners", json=spec)
    fields = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": f"0:{examples.PHANTOM_ROWS}"}
    return str(demo_client.upload(client, stack, lambda *_: None, scanner_id=scanner["id"], **fields)["id"])


def by_events(client: httpx.Client, job_id: str) -> None:
    """Wait for the event `end`."""
    with client.stream("GET", f"/v1/jobs/{job_id}/events") as stream:
        for line in stream.iter_lines():
            if line == "event: end":
                return


def processes(root: int | None = None) -> list[int]:
    """List a process and all its descendants; by default the service's: this process's descendants without itself."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int(_stat(folder)[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
    found = [root or os.getpid()]
    for known in found:
        found += [child for child, parent in parents.items() if parent == known]
    return found if root else found[1:]


def _stat(folder: Path) -> list[str]:
    return (folder / "stat").read_text().rpartition(")")[2].split()


def name_of(process_id: int) -> str:
    """Name the process's part in the service, from its command line."""
    command = Path(f"/proc/{process_id}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    parts = {"execution.attempt": "attempt", "execution.poller": "worker", " serve ": "API"}
    return next((part for words, part in parts.items() if words in command), command)


def pss_mib(process_id: int) -> float:
    """Return the process's memory, shared pages divided among their users."""
    lines = Path(f"/proc/{process_id}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def processor_s(root: int | None = None) -> float:
    """Return the processor seconds so far of the service's processes and their ended children."""
    ticks = 0
    for process_id in processes(root):
        try:
            ticks += sum(map(int, _stat(Path(f"/proc/{process_id}"))[11:15]))
        except (FileNotFoundError, ProcessLookupError):  # counted by its parent from now on
            continue
    return ticks / TICKS_PER_S


def settled(root: int | None = None) -> float:
    """Wait until the service takes less than half a core, as it does at rest; its processor seconds until then."""
    before = processor_s(root)
    while True:
        time.sleep(QUIET_S)
        now = processor_s(root)
        if now - before < 0.5 * QUIET_S:
            return now
        before = now


def calibrated(client: httpx.Client, scan_id: str, root: int | None = None) -> tuple[float, float]:
    """Measure the processor seconds of one calibration, and the seconds by the clock that it reports itself."""
    before = settled(root)
    asked = demo_client.post(client, "/v1/calibrations", json={"scan_id": scan_id})
    by_events(client, asked["job_id"])
    answer = demo_client.get(client, f"/v1/calibrations/{asked['id']}")
    assert answer["state"] == "succeeded", answer
    return settled(root) - before, answer["timing_s"]["total"]


def jobs_per_s(client: httpx.Client, scan_id: str, jobs: int) -> float:
    """Measure calibrations a second of a queue of them, from the first one's start to the last one's end."""
    asked = [demo_client.post(client, "/v1/calibrations", json={"scan_id": scan_id})["job_id"] for _ in range(jobs)]
    for job_id in asked:
        by_events(client, job_id)
    done = [demo_client.get(client, f"/v1/jobs/{job_id}") for job_id in asked]
    assert all(job["state"] == "succeeded" for job in done), done
    begun, ended = ([datetime.fromisoformat(job[name]) for job in done] for name in ("started_at", "finished_at"))
    return jobs / (max(ended) - min(begun)).total_seconds()


def measured(tree: Path, jobs: int) -> Json:
    """Measure the figures of the service of one checkout."""
    os.environ["PYTHONPATH"] = f"{tree / 'service'}:{tree / 'worker'}"
    # Kernels that an installation compiles once are no part of the price, nor of the memory.
    subprocess.run([sys.executable, "-m", "sawmill_command.commands", "compile"], check=True, capture_output=True)
    with tempfile.TemporaryDirectory(prefix="sawmill-price-") as name:
        folder = Path(name)
        with demo_client.running_service(folder) as client:
            scan_id = scan_of(client, folder, VIEWS)
            calibrated(client, scan_id)
            at_rest = settled()
            time.sleep(REST_S)
            rate = (processor_s() - at_rest) / REST_S
            memory = memory_by_part()
            price, passed = [], []
            for _ in range(jobs):
                started = time.monotonic()
                spent_s, core_s = calibrated(client, scan_id)
                price.append(spent_s - rate * (time.monotonic() - started))
                passed.append(core_s)
        figures: Json = {
            "job_processor_s": statistics.median(price),
            "least_processor_s": min(price),
            "most_processor_s": max(price),
            "calibration_s": statistics.median(passed),
            "rest_processor_share": rate,
            "rest_pss_mib": sum(memory.values()),
            "parts_pss_mib": memory,
        }
        with demo_client.running_service(folder, workers=2) as client:
            jobs_per_s(client, scan_id, 4)
            figures["two_workers_jobs_per_s"] = jobs_per_s(client, scan_id, QUEUED)
        if tree == HERE:  # an older checkout has no such setting
            with demo_client.running_service(folder, {"SAWMILL_SPARE_IDLE_S": "1"}) as client:
                calibrated(client, scan_id)
                time.sleep(REST_S)
                figures["long_rest_pss_mib"] = sum(memory_by_part().values())
    return figures


def memory_by_part() -> dict[str, float]:
    """Return the proportional set size of the service's parts; a template and its spare child are attempts both."""
    parts: dict[str, float] = defaultdict(float)
    for each in processes():
        parts[name_of(each)] += pss_mib(each)
    return parts


def print_row(name: str, figures: Json) -> None:
    """Print one checkout's figures as a line of the table."""
    parts = ", ".join(f"{part} {mib:.0f}" for part, mib in figures["parts_pss_mib"].items())
    print(
        f"{name:6} {figures['job_processor_s']:5.2f} s ({figures['least_processor_s']:.2f} to "
        f"{figures['most_processor_s']:.2f})   "
        f"{figures['calibration_s']:.2f} s   {figures['rest_pss_mib']:4.0f} MiB ({parts})   "
        f"{figures.get('long_rest_pss_mib', math.nan):4.0f} MiB   "
        f"{figures['two_workers_jobs_per_s']:.1f}/s with two workers   "
        f"{100 * figures['rest_processor_share']:.1f} %",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=10)
    parser.add_argument("--against", type=Path, help="another checkout, in the same environment")
    chosen = parser.parse_args()
    measurement = Measurement.begin(
        "worker/sawmill_platform", "worker/sawmill_worker/jobs", "worker/sawmill_tomography/calibration"
    )
    print("       processor a job, calibrated in, memory (PSS) after a job and long after, jobs a second, at rest")
    here = measured(HERE, chosen.jobs)
    print_row("here", here)
    if chosen.against:
        print_row("before", measured(chosen.against.resolve(), chosen.jobs))
    measurement.write({"job-price": here})


if __name__ == "__main__":
    main()
