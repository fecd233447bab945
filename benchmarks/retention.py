"""Seconds of retention with many logs: a preview, what is chosen, and a batch that goes. A log has a reconstruction.

Run: python benchmarks/retention.py [--logs 100000] [--queued 1000] [--postgresql]. In a temporary folder; rows have no
files, so that what is timed is the database. On PostgreSQL it needs the tests' packages.
"""

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from datetime import timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import insert

from sawmill_contracts import job_kinds
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.retention import RetentionAsk, RetentionRules
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobKind, JobState
from sawmill_platform.database.database import Database
from sawmill_platform.database.engines import make_engine
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_store.tables import ReconstructionRow, ScanRow

LOGS_A_DAY = 2000
LOG_BYTES = 230_400_000
VOLUME_BYTES = 50_000_000
BATCH = 5000
CONSTANTS = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)


def main() -> None:
    """Fill a store and print a line for each question."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=100_000, help="log scans, 2 000 a day, each reconstructed")
    parser.add_argument("--queued", type=int, default=1000, help="of these, the newest whose reconstruction waits")
    parser.add_argument("--postgresql", action="store_true", help="on a PostgreSQL server of its own")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, _url(on_server=options.postgresql) as url:
        settings = StorageSettings(data_folder=Path(folder), database_url=url)
        store = Store.open(settings)
        store.scanners.create(ScannerSpec(name="line", constants=CONSTANTS), scanner_id="line")
        fill(Database(make_engine(settings.url)), options.logs, options.queued)
        ask(store, options.logs)
        store.close()
    print(
        f"{'largest memory of this process':50s} {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:8.0f} MiB"
    )


def _url(*, on_server: bool) -> Any:  # noqa: ANN401 - a context of a URL or none
    if not on_server:
        return nullcontext(None)
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
    from postgres_server import PostgresServer  # noqa: PLC0415 - the tests' own

    server = PostgresServer()
    server.start()
    return server.database()


def ask(store: Store, logs: int) -> None:
    """Set rules that reach half of the logs, and all events but the last day's."""
    half = RetentionRules(log_scans_days=max(1, logs // LOGS_A_DAY // 2), log_scans_bytes=logs * LOG_BYTES // 2)
    rules = half.model_copy(update={"reconstructions_bytes": logs * VOLUME_BYTES // 2, "events_days": 1})
    preview = timed("preview of rules that reach half", lambda: store.retention.preview(rules))
    for kind in preview.kinds:
        if kind.number:
            print(f"  {kind.number} {kind.kind}, {(kind.bytes or 0) / 1e12:.2f} TB")
    ask_for = RetentionAsk(**rules.model_dump(), remove_at_most=preview.number)
    timed("putting them into force", lambda: store.retention.replace(ask_for))
    keeper = store.retention_keeper()
    timed("the keeper's first round: looks, and 50 logs", keeper.remove_some)
    timed("a further round", keeper.remove_some)
    timed("another", keeper.remove_some)


def timed(question: str, do: Callable[[], Any]) -> Any:  # noqa: ANN401 - what it answers
    """Print how long it took."""
    start = time.perf_counter()
    answer = do()
    print(f"{question:50s} {1e3 * (time.perf_counter() - start):8.1f} ms")
    return answer


def fill(database: Database, logs: int, queued: int) -> None:
    """Store logs at equal times until now, with their jobs and three events for each job."""
    apart = timedelta(days=1) / LOGS_A_DAY
    first = database.now() - logs * apart
    with database.write() as session:
        for start in range(0, logs, BATCH):
            numbers = range(start, min(start + BATCH, logs))
            times = {number: first + number * apart for number in numbers}
            session.execute(insert(JobRow), [_job("i", job_kinds.INGEST, n, at, done=True) for n, at in times.items()])
            jobs = [_job("r", job_kinds.RECONSTRUCT, n, at, done=n < logs - queued) for n, at in times.items()]
            session.execute(insert(JobRow), jobs)
            session.execute(insert(ScanRow), [_scan(n, at) for n, at in times.items()])
            session.execute(insert(ReconstructionRow), [_volume(n, at) for n, at in times.items()])
            session.execute(insert(EventRow), [each for n, at in times.items() for each in _events(n, at)])


def _job(prefix: str, kind: JobKind, number: int, at: Any, *, done: bool) -> dict[str, Any]:  # noqa: ANN401 - a time
    return {
        "id": f"{prefix}{number:08d}",
        "created_at": at,
        "kind": kind,
        "state": JobState.SUCCEEDED if done else JobState.QUEUED,
        "subject_id": f"{number:08d}",
    }


def _made(prefix: str, number: int, at: Any, size: int) -> dict[str, Any]:  # noqa: ANN401 - a time
    """Return the row of a job's product; the prefix is the job's."""
    job_id, identifier = f"{prefix}{number:08d}", f"{number:08d}"
    return {"id": identifier, "created_at": at, "scanner_id": "line", "job_id": job_id, "stored_bytes": size}


def _scan(number: int, at: Any) -> dict[str, Any]:  # noqa: ANN401 - a time
    return _made("i", number, at, LOG_BYTES) | {
        "spec": {},
        "state": ScanState.READY,
        "size_bytes": LOG_BYTES // 3,
        "sha256": "0" * 64,
        "reading": {"shape": {"views": 20}, "angular_range_deg": [0.0, 171.0]},
    }


def _volume(number: int, at: Any) -> dict[str, Any]:  # noqa: ANN401 - a time
    return _made("r", number, at, VOLUME_BYTES) | {"scan_id": f"{number:08d}", "options": {}}


def _events(number: int, at: Any) -> list[dict[str, Any]]:  # noqa: ANN401 - a time
    job = {"at": at, "job_id": f"i{number:08d}", "scanner_id": "line", "subject": "scan", "subject_id": f"{number:08d}"}
    return [{**job, "what": what} for what in (event_kinds.QUEUED, event_kinds.STARTED, event_kinds.SUCCEEDED)]


if __name__ == "__main__":
    main()
