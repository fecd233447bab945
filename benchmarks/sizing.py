"""The machine that a line needs: cores, memory and disk, from the jobs of one log on a real service.

    python benchmarks/sizing.py [--rows 2500]

`sawmill serve` runs as users start it, with one worker and an empty data folder. A log of a line is uploaded, read, and
reconstructed whole by `fbp` and by `auto`, one job after another. The system's own books are read (/proc): processor
seconds of all processes of the service, ended children included. The peak of memory of each attempt is what its last
event reports, and disk is what the files take. The table on docs/do/sizing.md multiplies these by the logs of a day.
The figures go to `benchmarks/results/sizing.json`.
"""

import argparse
import math
import tempfile
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import httpx
from http_latency import by_events
from job_price import processes, pss_mib, settled
from line_day import SHIFT_H, VIEWS
from measurement import Measurement
from memory import make_counts
from scanners import SCANNER
from scans import TRUE_THETA

from sawmill_command import demo_client
from sawmill_command.demo_client import Json

ROWS = 2500
METHODS = ("fbp", "auto")
# Lines, and logs a day of all of them.
MILLS = ((1, 500), (1, 2000), (2, 4000), (4, 8000))
# More than the mean, since logs come unevenly and calibrations come in between.
HEADROOM = 1.5
SYSTEM_GB, DAYS = 1.0, 14
# A worker may give one job that much (`attempts/limits.py`); it has about four cores.
JOB_GB, CORES_A_WORKER = 2.2, 4
TB = 1e12
# Folders of the data folder with what jobs leave.
RESULTS = ("uploads", "scans", "reconstructions")


@dataclass(frozen=True)
class Price:
    """What one job took."""

    processor_s: float
    clock_s: float
    peak_bytes: float
    disk_bytes: float


class Start(NamedTuple):
    """Processor seconds and bytes on the disk before a job."""

    processor_s: float
    disk_bytes: int


def main() -> None:
    """Measure the jobs of a log, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=ROWS, help="rows of the log")
    chosen = parser.parse_args()
    measurement = Measurement.begin()
    with tempfile.TemporaryDirectory(prefix="sawmill-sizing-") as name:
        folder = Path(name)
        make_counts(folder / "log.nxs", chosen.rows, number=VIEWS, fields=1)
        with demo_client.running_service(folder, workers=1) as client:
            prices, method = measured(client, folder, chosen.rows)
            settled()
            rest_gb = sum(map(pss_mib, processes())) * 2**20 / 1e9
    values = {name: asdict(price) for name, price in prices.items()}
    for name, price in prices.items():
        print(f"{name:6} {price}")
    table = markdown(prices, rest_gb)
    print(table)
    measurement.write({"sizing": {**values, "rest_gb": rest_gb, "auto_method": method, "table": table}})


def measured(client: httpx.Client, folder: Path, rows: int) -> tuple[dict[str, Price], str]:
    """Upload and read a log, and reconstruct it twice; return the price of each job, and the method of `auto`."""
    scanner = demo_client.post(client, "/v1/scanners", json={"name": "line", "constants": vars(SCANNER)})["id"]
    small = folder / "small.nxs"
    make_counts(small, 8, number=VIEWS, fields=1)
    warm = sent(client, small, scanner)
    for name in METHODS:  # a first job may compile
        ended(client, asked(client, warm["id"], 8, name)["job_id"], folder, Start(0.0, 0))
    prices = {}
    start = Start(settled(), disk_bytes(folder))
    scan = sent(client, folder / "log.nxs", scanner)
    prices["read"] = ended(client, scan["job_id"], folder, start)
    method = ""
    for name in METHODS:
        start = Start(settled(), disk_bytes(folder))
        reconstruction = asked(client, scan["id"], rows, name)
        prices[name] = ended(client, reconstruction["job_id"], folder, start)
        method = demo_client.get(client, f"/v1/reconstructions/{reconstruction['id']}")["result"]["method"]
    return prices, method


def sent(client: httpx.Client, file: Path, scanner: str) -> Json:
    """Upload a scan of counts, and wait until it is read."""
    with file.open("rb") as content:
        answer = client.post(
            "/v1/scans",
            params={"scanner_id": scanner, "data": "counts"},
            content=iter(lambda: content.read(2**20), b""),
            timeout=600.0,
        )
    answer.raise_for_status()
    scan: Json = answer.json()
    by_events(client, scan["job_id"])
    return scan


def asked(client: httpx.Client, scan_id: str, rows: int, method: str) -> Json:
    """Ask for the reconstruction of all rows."""
    ask = {"scan_id": scan_id, "theta": vars(TRUE_THETA), "method": method, "rows": f"0:{rows}"}
    return demo_client.post(client, "/v1/reconstructions", json=ask)


def ended(client: httpx.Client, job_id: str, folder: Path, start: Start) -> Price:
    """Wait for a job; return what it took since the start."""
    by_events(client, job_id)
    job = demo_client.get(client, f"/v1/jobs/{job_id}")
    history = demo_client.get(client, f"/v1/jobs/{job_id}/history")
    stamps = (datetime.fromisoformat(job[name]) for name in ("started_at", "finished_at"))
    started, finished = (stamp.timestamp() for stamp in stamps)
    peak = next(event["detail"]["peak_memory_bytes"] for event in history["events"] if event["what"] == "succeeded")
    disk = disk_bytes(folder) - start.disk_bytes
    return Price(settled() - start.processor_s, finished - started, peak, disk)


def disk_bytes(folder: Path) -> int:
    """Add up the files of uploads and results; a file of several names counts once."""
    files = [path for name in RESULTS for path in (folder / "data" / name).rglob("*") if path.is_file()]
    return sum({path.stat().st_ino: path.stat().st_size for path in files}.values())


def machine(prices: dict[str, Price], rest_gb: float, logs: int, method: str) -> tuple[int, int, float, float]:
    """Compute cores, gigabytes of memory, and terabytes of scans and of volumes of `DAYS`, for the logs of a day."""
    busy_s = logs * (prices["read"].processor_s + prices[method].processor_s)
    cores = max(2, math.ceil(HEADROOM * busy_s / (3600.0 * SHIFT_H)))
    workers = math.ceil(cores / CORES_A_WORKER)
    job_gb = max(JOB_GB, prices[method].peak_bytes / 1e9)
    memory = SYSTEM_GB + rest_gb + workers * job_gb
    scans, volumes = (DAYS * logs * prices[name].disk_bytes / TB for name in ("read", method))
    return cores, 2 ** math.ceil(math.log2(memory)), scans, volumes


def markdown(prices: dict[str, Price], rest_gb: float) -> str:
    """Write the table of the page."""
    lines = [
        f"| lines | logs a day, all lines | method | cores | memory | disk, {DAYS} days of scans | and of volumes |",
        "|--:|--:|---|--:|--:|--:|--:|",
    ]
    for count, logs in MILLS:
        for method in METHODS:
            cores, memory_gb, scans, volumes = machine(prices, rest_gb, logs, method)
            lines.append(
                f"| {count} | {logs} | `{method}` | {cores} | {memory_gb} GB | {scans:.1f} TB | {volumes:.1f} TB |"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
