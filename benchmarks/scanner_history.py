"""A year of one scanner: how long its history takes as a page, as JSON and as a file, and how much memory.

Run: python benchmarks/scanner_history.py [--entries 8000] [--database URL] [--data FOLDER]. On SQLite in a temporary
folder, or on an empty PostgreSQL database. A calibration a day that is activated, drift checks, and an alarm a month.
The values are made up. `--data` keeps the folder, so that `sawmill serve` shows /scanners/line-2/history.
"""

import argparse
import asyncio
import logging
import math
import random
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Any

import httpx
import structlog
from sqlalchemy import Engine, event, insert
from sqlalchemy.orm import Session

from sawmill_contracts import job_kinds, mill_events
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.measurements import MeasurementKind
from sawmill_contracts.scanners import ScannerSpec
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import EventClass, EventRow, JobRow
from sawmill_platform.settings import StorageSettings
from sawmill_service.app import create_app
from sawmill_service.history_file import history_csv
from sawmill_service.settings import ServiceSettings
from sawmill_store.mill_tables import CalibrationRow, MeasurementRow
from sawmill_store.store import Store

SEED, REPEATS, DAYS = 17, 5, 365
SCANNER_ID = "line-2"
BATCH = 5000
Row = dict[str, Any]


def main() -> None:
    """Fill a store and print a line for each question."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entries", type=int, default=8000, help="drift checks in the year")
    parser.add_argument("--database", help="an empty PostgreSQL database, postgresql://…")
    parser.add_argument("--data", type=Path, help="a new data folder to keep")
    options = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    with tempfile.TemporaryDirectory() as temporary:
        settings = StorageSettings(data_folder=options.data or Path(temporary), database_url=options.database)
        with closing(Store.open(settings)) as store:
            spec = ScannerSpec(name="Line 2", constants=ScannerConstants(859.46, 768, 1.502864583))
            store.scanners.create(spec, scanner_id=SCANNER_ID)
            fill(Database(make_engine(settings.url)), options.entries)
            ask(store)


def fill(database: Database, checks: int) -> None:
    """Store a year back from now, the oldest first."""
    now = database.now()
    with database.write() as session:
        rows = sorted([*calibrations(session, now), *drift_checks(now, checks)], key=lambda row: row["at"])
        for number, row in enumerate(rows, start=1):
            row["number"] = number
        insert_all(session, MeasurementRow, rows)
        entries = [entry_of(row) for row in rows] + [*activations(now), *alarms(now)]
        insert_all(session, EventRow, sorted(entries, key=lambda entry: entry["at"]))


def insert_all(session: Session, table: Any, rows: list[Row]) -> None:  # noqa: ANN401 - a table
    """Insert some thousands of rows at a time."""
    for start in range(0, len(rows), BATCH):
        session.execute(insert(table), rows[start : start + BATCH])


def calibrations(session: Session, now: datetime) -> Iterator[Row]:
    """Yield each day's calibration; the rows have no results, which a history does not read."""
    jobs, asked = [], []
    for day in range(DAYS):
        at, identifier = now - timedelta(days=DAYS - day, hours=3), f"calibration-{day:03}"
        job = {"id": identifier, "created_at": at, "kind": job_kinds.CALIBRATE, "state": JobState.SUCCEEDED}
        jobs.append(job | {"subject_id": identifier})
        about = {"scanner_id": SCANNER_ID, "scan_id": identifier, "phantom_id": "l-shape", "activate": True}
        options = CalibrationOptions().model_dump(mode="json")
        asked.append({"id": identifier, "created_at": at, "job_id": identifier, "options": options} | about)
        yield measured(at, MeasurementKind.CALIBRATION, identifier, day, noise=0.02)
    insert_all(session, JobRow, jobs)
    insert_all(session, CalibrationRow, asked)


def drift_checks(now: datetime, count: int) -> Iterator[Row]:
    """Yield drift checks evenly over the year."""
    for number in range(count):
        day = DAYS * number / count
        at = now - timedelta(days=DAYS - day)
        yield measured(at, MeasurementKind.DRIFT, f"drift-{number}", day, noise=0.05)


def measured(at: datetime, kind: MeasurementKind, identifier: str, day: float, *, noise: float) -> Row:
    """Return a measurement: a COR that drifts with the seasons and jumps once, with a slowly weaker source."""
    chance = random.Random(f"{SEED} {identifier}")  # noqa: S311 - no secret
    moved_mm = 0.3 * math.sin(day / 58.0) + (0.9 if 200 < day < 214 else 0.0) + chance.gauss(0.0, noise)
    phantom = kind is MeasurementKind.CALIBRATION
    return {
        "scanner_id": SCANNER_ID,
        "at": at,
        "kind": kind,
        "subject_id": identifier,
        "against_id": "calibration-000",
        "ray_change_mm": abs(moved_mm) * 0.57,
        "ray_change_tolerance_mm": 0.5,
        "within_tolerance": abs(moved_mm) * 0.57 < 0.5,
        "cor_column_mm": -209.1 + moved_mm,
        "cor_column_standard_deviation_mm": noise,
        "cor_column_change_mm": moved_mm,
        "tilt_rad": math.radians(-4.76 + chance.gauss(0.0, noise)),
        "tilt_standard_deviation_rad": math.radians(noise),
        "source_to_detector_mm": 1619.3 + chance.gauss(0.0, 0.4),
        "source_to_detector_standard_deviation_mm": 0.4 if phantom else None,
        "relative_residual": 0.012 + abs(chance.gauss(0.0, 0.001)),
        "gain": 0.021 - 2e-6 * day + chance.gauss(0.0, 2e-5) if phantom else None,
        "verdict": "pass" if phantom else None,
    }


def entry_of(row: Row) -> Row:
    """Return the entry of a measurement."""
    phantom = row["kind"] is MeasurementKind.CALIBRATION
    entry = about(row["at"], HistoryKind.CALIBRATION if phantom else HistoryKind.DRIFT_CHECK, event_kinds.SUCCEEDED)
    subject = {"subject": "calibration" if phantom else "drift", "subject_id": row["subject_id"]}
    return entry | subject | {"why": "nothing moved beyond the tolerance"}


def activations(now: datetime) -> Iterator[Row]:
    """Yield the activation of each calibration, an hour later."""
    for day in range(DAYS):
        entry = about(
            now - timedelta(days=DAYS - day, hours=2), HistoryKind.ACTIVATION, mill_events.CALIBRATION_ACTIVATED
        )
        why = "the rays pass; schedule nightly asked for activation on pass"
        yield entry | {"subject": "calibration", "subject_id": f"calibration-{day:03}", "why": why}


def alarms(now: datetime) -> Iterator[Row]:
    """Yield one alarm a month, for two days."""
    for month in range(1, 12):
        for what, days in ((mill_events.ALARM_OPENED, 0), (mill_events.ALARM_CLOSED, 2)):
            entry = about(now - timedelta(days=30 * month - days), HistoryKind.ALARM, what)
            yield entry | {"detail": {"what": AlarmKind.SCANNER_QUIET}, "why": "no scan came for 24 hours"}


def about(at: datetime, kind: HistoryKind, what: EventKind) -> Row:
    """Return the fields that every entry has."""
    names = ("key_id", "why", "detail")
    known = {
        "group_id": SCANNER_ID,
        "at": at,
        "event_class": EventClass.WORK,
        "topic": kind,
        "what": what,
        "who": "schedule nightly",
    }
    return dict.fromkeys(names) | known | {"subject": "scanner", "subject_id": SCANNER_ID}


def ask(store: Store) -> None:
    """Request everything that a person or a program requests."""
    first, end = store.now() - timedelta(days=DAYS), store.now()
    half = first + timedelta(days=DAYS / 2)
    middle = store.history.page(SCANNER_ID, until=half).next
    report("the newest 50", lambda: store.history.page(SCANNER_ID))
    report("200 after half of them", lambda: store.history.page(SCANNER_ID, after=middle, limit=200))
    report("50 before a day of half a year ago", lambda: store.history.page(SCANNER_ID, until=half))
    report("50 alarms", lambda: store.history.page(SCANNER_ID, kind=HistoryKind.ALARM))
    report("measurements of the year for the chart", lambda: store.measurements.movements_of(SCANNER_ID, first, end))
    report("activations and alarms for the chart", lambda: store.history.marks(SCANNER_ID, first))
    app = create_app(ServiceSettings(), store, lambda _: None)
    for path in (
        f"/v1/scanners/{SCANNER_ID}/history/entries",
        f"/scanners/{SCANNER_ID}/history?days=30",
        f"/scanners/{SCANNER_ID}/history?days=365",
        f"/scanners/{SCANNER_ID}/history?days=730&last={end:%Y-%m-%d}&kind=alarm",
    ):
        size = report(path, lambda path=path: asyncio.run(get(app, path)))
        print(f"{'':48s} {size:8d} bytes")
    tracemalloc.start()
    start, size = time.perf_counter(), 0
    for part in history_csv(store.history.all(SCANNER_ID)):
        size += len(part)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    taken_s = time.perf_counter() - start
    print(f"the whole file: {size / 1e6:.1f} MB in {taken_s:.1f} s (traced), at most {peak / 1e6:.1f} MB held")


async def get(app: Any, path: str) -> int:  # noqa: ANN401 - an ASGI application
    """Return the size of an answer, bytes."""
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8000") as client:
        answer = await client.get(path)
    return len(answer.raise_for_status().content)


def report(what: str, do: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever it answers
    """Print the median of some times, and the number of statements."""
    statements: list[str] = []

    def note(*sent: Any) -> None:  # noqa: ANN401 - what SQLAlchemy tells
        statements.append(sent[2])

    event.listen(Engine, "before_cursor_execute", note)
    answer = do()
    event.remove(Engine, "before_cursor_execute", note)
    queries = sum(statement.startswith("SELECT") for statement in statements)
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        do()
        times.append(time.perf_counter() - start)
    print(f"{what:48s} {1e3 * median(times):8.1f} ms, {queries} queries")
    return answer


if __name__ == "__main__":
    main()
