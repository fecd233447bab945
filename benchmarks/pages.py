"""Milliseconds on the server and bytes of each page and of each list, with many scanners, scans and jobs.

    python benchmarks/pages.py [--scanners 50] [--scans 10000] [--checks 1] [--data FOLDER]

On SQLite, in a temporary folder, or in FOLDER, which is kept. One scan in ten is of a phantom and has a calibration;
the others have drift checks and a reconstruction. Answers are the tests'; no file is behind a scan.
Milliseconds are the median of five requests without a network, and next to them of processor time; kilobytes are
the page with its styles and scripts, not packed.
"""

import argparse
import asyncio
import logging
import re
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import httpx
import structlog
from sqlalchemy import insert
from sqlalchemy.orm import Session

from sawmill_contracts import kinds
from sawmill_platform.contracts import event_kinds

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tests/support"))
import results  # noqa: E402

from sawmill_contracts.geometry import ScannerConstants  # noqa: E402
from sawmill_contracts.scanners import ScannerSpec  # noqa: E402
from sawmill_contracts.scans import ScanState  # noqa: E402
from sawmill_platform.contracts.jobs import JobKind, JobState, Priority  # noqa: E402
from sawmill_platform.contracts.kind_declarations import declaration_of  # noqa: E402
from sawmill_platform.database.database import Database  # noqa: E402
from sawmill_platform.database.engines import make_engine  # noqa: E402
from sawmill_platform.database.tables import EventRow, JobRow  # noqa: E402
from sawmill_platform.settings import StorageSettings  # noqa: E402
from sawmill_service.app import create_app  # noqa: E402
from sawmill_service.pages.all_pages import PAGES  # noqa: E402
from sawmill_service.settings import ServiceSettings  # noqa: E402
from sawmill_store.drift.measurements import record_measurement  # noqa: E402
from sawmill_store.mill_tables import ActivationRow, CalibrationRow, DriftRow, ReconstructionRow, ScanRow  # noqa: E402
from sawmill_store.store import Store  # noqa: E402

REPEATS = 5
BATCH = 500
DAYS = 365
ORIGIN = "http://127.0.0.1:8000"
# Most logs move a scanner a little, some nearly too far, a few too far.
MOVED_MM = (0.02, 0.05, 0.08, 0.12, 0.06, 0.43, 0.1, 0.62)


def main() -> None:
    """Fill a store and print a line a page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scanners", type=int, default=50)
    parser.add_argument("--scans", type=int, default=10_000)
    parser.add_argument("--checks", type=int, default=1, help="drift checks of each scan of a log")
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    with folder_of(options.data) as folder:
        settings = StorageSettings(data_folder=folder, database_url=None)
        store = Store.open(settings)
        if not store.scanners.page(limit=1).items:
            fill(store, Database(make_engine(settings.url)), options.scanners, options.scans, options.checks)
        for path, status, took_ms, worked_ms, size in asyncio.run(measured(store)):
            print(f"{path:44s} {status} {took_ms:8.1f} ms {worked_ms:8.1f} ms {size / 1000:8.1f} kB")
        store.close()


@contextmanager
def folder_of(given: Path | None) -> Iterator[Path]:
    """Yield the folder that was given, or a temporary one."""
    if given is not None:
        yield given
        return
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


def fill(store: Store, database: Database, scanners: int, scans: int, checks: int) -> None:
    """Store scanners in all states, and scans over a year, the same number for each."""
    now = store.now()
    each = scans // scanners
    for number in range(scanners):
        spec = ScannerSpec(name=f"Line {number + 1}", constants=ScannerConstants(**results.CONSTANTS))
        scanner_id = store.scanners.create(spec, scanner_id=f"line-{number + 1}").id
        if number % 25 == 24:
            continue  # new
        times = [now - timedelta(days=DAYS * (place + 0.5) / each) for place in reversed(range(each))]
        moved_mm = MOVED_MM[number % len(MOVED_MM)]
        for start in range(0, each, BATCH):
            with database.write() as session:
                fill_scanner(session, scanner_id, times, range(start, min(start + BATCH, each)), moved_mm, checks)


def fill_scanner(
    session: Session, scanner_id: str, times: list[datetime], places: range, moved_mm: float, checks: int
) -> None:
    """Add scans: one in ten with a calibration, which is accepted, and logs between; the last check moved this far."""
    for place in places:
        at = times[place]
        scan_id = f"{scanner_id}-{place}"
        made: dict[str, Any] = {"created_at": at, "scanner_id": scanner_id}
        of_log = bool(place % 10)
        names = [kinds.DRIFT] * checks + [kinds.RECONSTRUCT] if of_log else [kinds.CALIBRATE]
        jobs = [job(scan_id, scan_id, kinds.INGEST, at)]
        jobs += [job(f"{scan_id}-job-{number}", f"{scan_id}-{number}", kind, at) for number, kind in enumerate(names)]
        session.execute(insert(JobRow), jobs)
        session.execute(insert(EventRow), [each for one in jobs for each in events(one, scanner_id)])
        scan = ScanRow(
            id=scan_id,
            **made,
            phantom_id=None if of_log else "l-shape",
            spec={"data": "counts", "name": f"scan {place}"},
            state=ScanState.READY,
            size_bytes=10**8,
            sha256="0" * 64,
            reading=results.reading(),
            job_id=scan_id,
        )
        session.add(scan)
        session.flush()
        for number, kind in enumerate(names):
            asked = made | {"id": f"{scan_id}-{number}", "scan_id": scan_id, "job_id": f"{scan_id}-job-{number}"}
            active_id = f"{scanner_id}-{place - place % 10}-0"
            share = 1.0 if place == len(times) - 1 else (place % 10) / 10.0
            moved = moved_mm * share
            if kind is kinds.CALIBRATE:
                answer = results.calibration_result(scanner=results.CONSTANTS)
                row: Any = CalibrationRow(**asked, options={}, phantom_id="l-shape", activate=True, result=answer)
            elif kind is kinds.DRIFT:
                answer = results.drift_result(ray_change_mm=moved, within_tolerance=moved <= 0.5)
                row = DriftRow(**asked, options={}, calibration_id=active_id, result=answer)
            else:
                about = {"options": {"scan_id": scan_id}, "calibration_id": active_id}
                row = ReconstructionRow(**asked, **about, result=results.reconstruction_result())
            session.add(row)
            session.flush()
            if kind is kinds.CALIBRATE:
                session.add(
                    ActivationRow(scanner_id=scanner_id, calibration_id=row.id, activated_at=at, reason="the rays pass")
                )
            record_measurement(session, row, results.answer_of(kind, row.result), at)
        session.expunge_all()


def job(job_id: str, subject_id: str, kind: JobKind, at: datetime) -> dict[str, Any]:
    """Return a job that succeeded a minute later."""
    return {
        "id": job_id,
        "created_at": at,
        "kind": kind,
        "state": JobState.SUCCEEDED,
        "subject_id": subject_id,
        "priority": Priority.INTERACTIVE,
        "short": True,
        "attempt": 1,
        "beats": 0,
        "losses": 0,
        "outages": 0,
        "cancel_requested": False,
        "started_at": at,
        "finished_at": at + timedelta(minutes=1),
    }


def events(of: dict[str, Any], scanner_id: str) -> list[dict[str, Any]]:
    """Return a job's events: it was queued, and it succeeded."""
    about = {"scanner_id": scanner_id, "subject": declaration_of(of["kind"]).noun, "subject_id": of["subject_id"]}
    both = ((of["created_at"], event_kinds.QUEUED), (of["finished_at"], event_kinds.SUCCEEDED))
    return [about | {"at": at, "type": what, "job_id": of["id"]} for at, what in both]


class Measured(NamedTuple):
    """The price of one page or list."""

    path: str
    status: int
    took_ms: float
    worked_ms: float
    size_bytes: int


async def measured(store: Store) -> list[Measured]:
    """Request each page and each list in turn."""
    app = create_app(ServiceSettings(), store, lambda _: None)
    transport = httpx.ASGITransport(app)
    answers = []
    async with httpx.AsyncClient(transport=transport, base_url=ORIGIN) as client:
        for path in (*paths(store), *lists()):
            asked = {"Accept": "application/json" if path.startswith("/v1") else "text/html"}
            answer = await client.get(path, headers=asked)
            if not answer.headers.get("Content-Type", "").startswith(asked["Accept"]):
                continue
            took, worked = [], []
            for _ in range(REPEATS):
                start, start_of_work = time.perf_counter(), time.process_time()
                answer = await client.get(path, headers=asked)
                took.append(1e3 * (time.perf_counter() - start))
                worked.append(1e3 * (time.process_time() - start_of_work))
            size = len(answer.content)
            if not path.startswith("/v1"):
                size += await size_of_parts(client, answer.text)
            answers.append(Measured(path, answer.status_code, median(took), median(worked), size))
    return answers


def paths(store: Store) -> list[str]:
    """List the paths of every page, with ids of stored objects."""
    calibration = store.calibrations.page(limit=1).items[0]
    ids = {
        "scanner_id": calibration.scanner_id,
        "calibration_id": calibration.id,
        "scan_id": calibration.scan_id,
        "phantom_id": "l-shape",
        "job_id": calibration.job_id,
        # The longest of the documents.
        "path": "look-up/codes",
    }
    routes = [route for router in PAGES for route in router.routes if "GET" in route.methods]
    # A path's parameter may name its converter: {path:path}.
    known = [re.sub(r":\w+}", "}", route.path) for route in routes]
    return [path.format(**ids) for path in known if set(re.findall(r"{(\w+)}", path)) <= ids.keys()]


def lists() -> Iterator[str]:
    """List the paths of lists, whole and filtered, also by values with few or no results, which take the longest."""
    yield from (f"/v1/{name}" for name in ("audit", "scanners", "phantoms", "alarms", "schedules"))
    yield from (f"/v1/scanners/line-1/{name}" for name in ("drift", "history/entries", "measurements"))
    kind_names = map(str, JobKind.all())
    narrowed: dict[str, tuple[str, Iterable[str], Iterable[str]]] = {"jobs": ("kind", kind_names, JobState)}
    for name in ("calibrations", "drifts", "reconstructions"):
        narrowed[name] = ("scanner_id", ("line-1", "none"), JobState)
    narrowed["scans"] = ("scanner_id", ("line-1", "none"), ScanState)
    for name, (field, values, states) in narrowed.items():
        chosen = ["", *(f"&{field}={value}" for value in values)]
        for state in ["", *(f"&state={state}" for state in states)]:
            yield from (f"/v1/{name}?limit=200{one}{state}" for one in chosen)
    for name in ("calibrations", "drifts", "reconstructions", "scans"):
        yield f"/v1/{name}?created_before=2000-01-01T00:00:00Z"
    yield f"/scans?scanner_id=line-1&state={ScanState.REFUSED}"


async def size_of_parts(client: httpx.AsyncClient, html: str) -> int:
    """Sum the bytes of the styles and scripts that a page names, and of the scripts that those import."""
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
