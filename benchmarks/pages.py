"""Milliseconds on the server and bytes of each page, with many scanners and scans.

    python benchmarks/pages.py [--scanners 50] [--scans 10000] [--data FOLDER]

On SQLite, in a temporary folder, or in FOLDER, which is kept. Each scan has a calibration or a drift check, whose
answers are those of the tests; no file is behind a scan. Milliseconds are the median of five requests without a
network, and beside them those of processor time; kilobytes are the page with its styles and scripts, not packed.
"""

import argparse
import asyncio
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Any

import httpx
from sqlalchemy import insert

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests/support"))
import results  # noqa: E402

from sawmill_service.app import create_app  # noqa: E402
from sawmill_service.pages.all_pages import PAGES  # noqa: E402
from sawmill_service.settings import ServiceSettings  # noqa: E402
from sawmill_worker.contracts.geometry import ScannerConstants  # noqa: E402
from sawmill_worker.contracts.jobs import JobKind, JobState, Priority  # noqa: E402
from sawmill_worker.contracts.scanners import ScannerSpec  # noqa: E402
from sawmill_worker.contracts.scans import ScanState  # noqa: E402
from sawmill_worker.storage.database import Database  # noqa: E402
from sawmill_worker.storage.engines import make_engine  # noqa: E402
from sawmill_worker.storage.measurements import record_measurement  # noqa: E402
from sawmill_worker.storage.settings import StorageSettings  # noqa: E402
from sawmill_worker.storage.store import Store  # noqa: E402
from sawmill_worker.storage.tables import ActivationRow, CalibrationRow, DriftRow, JobRow, ScanRow  # noqa: E402

REPEATS = 5
DAYS = 365
ORIGIN = "http://127.0.0.1:8000"
# Most logs move a scanner a little, some nearly too far, a few too far.
MOVED_MM = (0.02, 0.05, 0.08, 0.12, 0.06, 0.43, 0.1, 0.62)


def main() -> None:
    """Fill a store and print a line a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scanners", type=int, default=50)
    parser.add_argument("--scans", type=int, default=10_000)
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    with folder_of(options.data) as folder:
        settings = StorageSettings(data_folder=folder, database_url=None)
        store = Store.open(settings)
        if not store.scanners.page(limit=1).items:
            fill(store, Database(make_engine(settings.url)), options.scanners, options.scans)
        asyncio.run(measure(store))
        store.close()


@contextmanager
def folder_of(given: Path | None) -> Iterator[Path]:
    """The folder that was given, or one that goes."""
    if given is not None:
        yield given
        return
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


def fill(store: Store, database: Database, scanners: int, scans: int) -> None:
    """Scanners in all states, and scans over a year, the same number for each."""
    now = store.now()
    each = scans // scanners
    for number in range(scanners):
        spec = ScannerSpec(name=f"Line {number + 1}", constants=ScannerConstants(**results.CONSTANTS))
        scanner_id = store.scanners.create(spec, scanner_id=f"line-{number + 1}").id
        if number % 25 == 24:
            continue  # new
        times = [now - timedelta(days=DAYS * (place + 0.5) / each) for place in reversed(range(each))]
        fill_scanner(database, scanner_id, times, moved_mm=MOVED_MM[number % len(MOVED_MM)])


def fill_scanner(database: Database, scanner_id: str, times: list[datetime], *, moved_mm: float) -> None:
    """A calibration once in ten scans, which is accepted, and drift checks between; the last one moved this far."""
    with database.write() as session:
        active_id = ""
        for place, at in enumerate(times):
            scan_id = f"{scanner_id}-{place}"
            kind = JobKind.DRIFT if place % 10 else JobKind.CALIBRATE
            session.execute(insert(JobRow), [job(scan_id, JobKind.INGEST, at), job(f"of-{scan_id}", kind, at)])
            scan = ScanRow(
                id=scan_id,
                created_at=at,
                scanner_id=scanner_id,
                phantom_id=None if place % 10 else "l-shape",
                spec={"data": "counts", "name": f"scan {place}"},
                state=ScanState.READY,
                size_bytes=10**8,
                sha256="0" * 64,
                reading=results.reading(),
                job_id=scan_id,
            )
            asked: dict[str, Any] = {
                "id": scan_id,
                "created_at": at,
                "scanner_id": scanner_id,
                "scan_id": scan_id,
                "job_id": f"of-{scan_id}",
                "options": {},
            }
            if kind is JobKind.CALIBRATE:
                active_id = scan_id
                answer = results.calibration_result(scanner=results.CONSTANTS)
                row: CalibrationRow | DriftRow = CalibrationRow(
                    **asked, phantom_id="l-shape", activate=True, result=answer
                )
                activation = ActivationRow(
                    scanner_id=scanner_id, calibration_id=scan_id, activated_at=at, reason="the rays pass"
                )
                session.add_all([scan, row])
                session.flush()
                session.add(activation)
            else:
                share = 1.0 if place == len(times) - 1 else (place % 10) / 10.0
                moved = moved_mm * share
                answer = results.drift_result(ray_change_mm=moved, within_tolerance=moved <= 0.5)
                row = DriftRow(**asked, calibration_id=active_id, result=answer)
                session.add_all([scan, row])
                session.flush()
            record_measurement(session, row, at)


def job(job_id: str, kind: JobKind, at: datetime) -> dict[str, Any]:
    """One that succeeded a minute later."""
    return {
        "id": job_id,
        "created_at": at,
        "kind": kind,
        "state": JobState.SUCCEEDED,
        "subject_id": job_id.removeprefix("of-"),
        "priority": Priority.WAITED_FOR,
        "short": True,
        "attempt": 1,
        "beats": 0,
        "losses": 0,
        "outages": 0,
        "cancel_requested": False,
        "started_at": at,
        "finished_at": at + timedelta(minutes=1),
    }


async def measure(store: Store) -> None:
    """Ask for each page in turn."""
    app = create_app(ServiceSettings(), store, lambda _: None)
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url=ORIGIN, headers={"Accept": "text/html"}) as client:
        for path in paths(store):
            answer = await client.get(path)
            if "text/html" not in answer.headers.get("Content-Type", ""):
                continue
            took, worked = [], []
            for _ in range(REPEATS):
                start, start_of_work = time.perf_counter(), time.process_time()
                answer = await client.get(path)
                took.append(1e3 * (time.perf_counter() - start))
                worked.append(1e3 * (time.process_time() - start_of_work))
            kilobytes = (len(answer.content) + await size_of_parts(client, answer.text)) / 1000
            print(
                f"{path:44s} {answer.status_code} {median(took):8.1f} ms {median(worked):8.1f} ms {kilobytes:8.1f} kB"
            )


def paths(store: Store) -> list[str]:
    """Of every page, with ids of what there is."""
    calibration = store.calibrations.page(limit=1).items[0]
    ids = {
        "scanner_id": calibration.scanner_id,
        "calibration_id": calibration.id,
        "scan_id": calibration.scan_id,
        "phantom_id": "l-shape",
        "job_id": calibration.job_id,
    }
    routes = [route for router in PAGES for route in router.routes if "GET" in route.methods]
    known = [route.path for route in routes if set(re.findall(r"{(\w+)}", route.path)) <= ids.keys()]
    return [path.format(**ids) for path in known]


async def size_of_parts(client: httpx.AsyncClient, html: str) -> int:
    """Bytes of the styles and scripts that a page names, and of the scripts that those import."""
    wanted = re.findall(r'(?:<script[^>]* src|rel="stylesheet" href)="([^"]+)"', html)
    seen: set[str] = set()
    size = 0
    while wanted:
        path = wanted.pop()
        if path in seen:
            continue
        seen.add(path)
        text = (await client.get(path)).text
        size += len(text.encode())
        wanted += [str(Path(path).parent / name) for name in re.findall(r'from "\./([^"]+)"', text)]
    return size


if __name__ == "__main__":
    main()
