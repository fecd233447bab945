"""Latency of an answer over HTTP, compared with the core's own time, on the embedded default.

    python benchmarks/http_latency.py [--repeats 15] [--views 360]

A service with a separate folder, one simulated stack, calibrations requested one after the other, each after a pause
in which the service has nothing to do. The time runs from the request to the whole answer in the client's hands, once
by server-sent events and once by asking every 50 ms; `timing_s.total` is taken off, and what is left is split by the
job's own times. A request that computes nothing is timed too, to show the machine's other load.
"""

import argparse
import datetime as dt
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import httpx

from sawmill_command import demo_client, examples
from sawmill_command.demo_client import Json

PAUSE_S = 2.0
Wait = Callable[[httpx.Client, str], None]


def by_events(client: httpx.Client, job_id: str) -> None:
    """Wait for the event `end`."""
    with client.stream("GET", f"/v1/jobs/{job_id}/events") as stream:
        for line in stream.iter_lines():
            if line == "event: end":
                return


def by_asking(client: httpx.Client, job_id: str) -> None:
    """Poll the job until it has ended."""
    demo_client.wait(client, job_id, lambda *_: None)


def answered(client: httpx.Client, scan_id: str, wait: Wait) -> Json:
    """Measure the seconds from the request to the answer, by what they were spent on."""
    started = time.time()
    asked = demo_client.post(client, "/v1/calibrations", json={"scan_id": scan_id})
    wait(client, asked["job_id"])
    answer = demo_client.get(client, f"/v1/calibrations/{asked['id']}")
    ended = time.time()
    assert answer["state"] == "succeeded", answer
    job = demo_client.get(client, f"/v1/jobs/{asked['job_id']}")
    begun, done = (dt.datetime.fromisoformat(job[name]).timestamp() for name in ("started_at", "finished_at"))
    core = answer["timing_s"]["total"]
    return {
        "answer": ended - started,
        "core (timing_s.total)": core,
        "answer less core": ended - started - core,
        "  until a worker has claimed it": begun - started,
        "  reading and writing files": done - begun - core,
        "  until the client knows": ended - done,
        "report": answer["links"]["report"],
    }


def print_seconds(name: str, seconds: Sequence[float]) -> None:
    """Print one line of the table."""
    print(f"  {name:<34} median {statistics.median(seconds):6.3f} s   max {max(seconds):6.3f} s", flush=True)


def measure(client: httpx.Client, scan_id: str, name: str, wait: Wait, repeats: int) -> None:
    """Print the times of a number of calibrations."""
    rows = []
    for _ in range(repeats):
        time.sleep(PAUSE_S)
        started = time.perf_counter()
        client.get("/health/live").raise_for_status()
        nothing = time.perf_counter() - started
        rows.append({**answered(client, scan_id, wait), "a request that computes nothing": nothing})
    print(f"{name}, {repeats} calibrations")
    for part in rows[0]:
        if part != "report":
            print_seconds(part, [row[part] for row in rows])


def pictures(client: httpx.Client, scan_id: str) -> None:
    """Print the times of the report's picture: drawn on the first request, kept for the next."""
    report = answered(client, scan_id, by_events)["report"]
    for name in ("report drawn", "report kept"):
        started = time.perf_counter()
        client.get(report).raise_for_status()
        print(f"  {name:<34} {time.perf_counter() - started:6.3f} s")


def scan_of(client: httpx.Client, folder: Path, views: int) -> str:
    """Create a scanner, and a stack of it with the phantom on a log's end, read and ready; return the scan's id."""
    stack = folder / "stack.h5"
    examples.write_mill_stack(stack, views, examples.mill_slices())
    # An earlier version, with which the guard compares, does not know all fields.
    spec = {"name": "line", "constants": {name: value for name, value in vars(examples.SCANNER).items() if value != ()}}
    scanner = demo_client.post(client, "/v1/scanners", json=spec)
    fields = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": f"0:{examples.PHANTOM_ROWS}"}
    scan = demo_client.upload(client, stack, lambda *_: None, scanner_id=scanner["id"], **fields)
    return str(scan["id"])


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15, help="calibrations for each way of waiting")
    parser.add_argument("--views", type=int, default=360)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sawmill-latency-") as name:
        folder = Path(name)
        with demo_client.running_service(folder) as client:
            scan_id = scan_of(client, folder, chosen.views)
            answered(client, scan_id, by_events)  # the first job of an installation compiles
            measure(client, scan_id, "by events", by_events, chosen.repeats)
            measure(client, scan_id, "by asking every 50 ms", by_asking, chosen.repeats)
            pictures(client, scan_id)


if __name__ == "__main__":
    main()
