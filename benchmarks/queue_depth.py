"""Seconds of what is asked of the store while many jobs wait: lists, places, claims, health, metrics.

Run: python benchmarks/queue_depth.py [--depth 100000] [--ended 100000]. On SQLite, in a temporary folder.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from statistics import median

from sqlalchemy import insert

from sawmill_worker.contracts.events import EventKind
from sawmill_worker.contracts.jobs import JobKind, JobState, Priority
from sawmill_worker.storage.database import Database
from sawmill_worker.storage.engines import make_engine
from sawmill_worker.storage.events import PEAK_MEMORY
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store
from sawmill_worker.storage.tables import EventRow, JobRow

REPEATS = 5
PAGE = 200


def main() -> None:
    """Fill a store and print a line for each question."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--depth", type=int, default=100_000, help="queued jobs")
    parser.add_argument("--ended", type=int, default=100_000, help="jobs that have succeeded")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        settings = StorageSettings(data_folder=Path(folder), database_url=None)
        store = Store.open(settings)
        fill(Database(make_engine(settings.url)), options.depth, options.ended)
        newest = store.jobs.page(limit=1).items[0].id
        report(f"a list of {PAGE} jobs", lambda: store.jobs.page(limit=PAGE))
        report(f"a list of {PAGE} queued jobs", lambda: store.jobs.page(limit=PAGE, state=JobState.QUEUED))
        report("a list of one kind", lambda: store.jobs.page(limit=PAGE, kind=JobKind.PLAN, state=JobState.QUEUED))
        report("the last job's place", lambda: store.jobs.get(newest))
        report("a claim", lambda: store.jobs.claim("benchmark"))
        report("a claim of a short job", lambda: store.jobs.claim("benchmark", short=True))
        report("wake-ups lost", lambda: store.jobs.queued_job_ids(older_than_s=5.0, limit=100))
        report("jobs by state", store.jobs.counts)
        start = time.perf_counter()
        store.tallies.read()
        print(f"{'counts for metrics, the first':30s} {1e3 * (time.perf_counter() - start):8.1f} ms")
        report("counts for metrics", store.tallies.read)
        store.close()


def fill(database: Database, depth: int, ended: int) -> None:
    """Jobs a second apart, the last ones an hour ago; one in ten is short, one in a thousand a plan."""
    first = database.now() - timedelta(seconds=depth + ended + 3600)

    def row(number: int) -> dict[str, object]:
        at = first + timedelta(seconds=number)
        done = number < ended
        kind = JobKind.PLAN if number % 1000 == 0 else JobKind.DRIFT if number % 10 == 0 else JobKind.RECONSTRUCT
        return {
            "id": f"{number:08d}",
            "created_at": at,
            "kind": kind,
            "state": JobState.SUCCEEDED if done else JobState.QUEUED,
            "subject_id": f"{number:08d}",
            "priority": Priority.BATCH if number % 3 == 0 else Priority.WAITED_FOR,
            "short": number % 10 == 0,
            "started_at": at if done else None,
            "finished_at": at + timedelta(seconds=20) if done else None,
        }

    with database.write() as session:
        for start in range(0, depth + ended, 10_000):
            numbers = range(start, min(start + 10_000, depth + ended))
            rows = [row(number) for number in numbers]
            session.execute(insert(JobRow), rows)
            events = [event for job in rows if job["finished_at"] for event in _events(job)]
            if events:
                session.execute(insert(EventRow), events)


def _events(job: dict[str, object]) -> list[dict[str, object]]:
    attempt = {"job_id": job["id"], "attempt": 1, "worker": "benchmark"}
    ended = {**attempt, "what": EventKind.SUCCEEDED, "at": job["finished_at"], "detail": {PEAK_MEMORY: 4e8}}
    return [{**attempt, "what": EventKind.STARTED, "at": job["started_at"], "detail": None}, ended]


def report(question: str, ask: Callable[[], object]) -> None:
    """A line."""
    print(f"{question:30s} {milliseconds(ask, REPEATS):8.1f} ms")


def milliseconds(ask: Callable[[], object], times: int) -> float:
    """The median of some times, after one that fills caches."""
    ask()
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        ask()
        taken.append(time.perf_counter() - started)
    return 1e3 * median(taken)


if __name__ == "__main__":
    main()
