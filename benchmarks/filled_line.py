"""A running service whose queue is filled from outside, and its requests in the meantime (`benchmarks/load.py`)."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from itertools import count
from statistics import median
from urllib.parse import urlencode

import httpx
from scanners import SCANNER
from scans import TRUE_THETA
from sqlalchemy import func, insert, select

from sawmill_command import demo_client
from sawmill_contracts import kinds
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.tables import EventRow, JobRow
from sawmill_store.mill_tables import PlanRow
from sawmill_store.store import Store

CLIENTS, PAGE_JOBS = 4, 50
WINDOW_S, NOBODY_WORKS_S = 6.0, 60.0


class Line:
    """A running service whose queue is filled from outside.

    Parameters
    ----------
    client, store
        The service, and its database.
    """

    def __init__(self, client: httpx.Client, store: Store) -> None:
        self.client, self.store = client, store
        self.scanner_id = demo_client.post(client, "/v1/scanners", json={"name": "line", "constants": vars(SCANNER)})[
            "id"
        ]
        self._numbers = count()

    def ask(self) -> str:
        """Request a plan; return the id of the job."""
        body = {"scanner_id": self.scanner_id, "views": 20, "theta": vars(TRUE_THETA)}
        return str(demo_client.post(self.client, "/v1/phantoms/l-shape/plans", json=body)["job_id"])

    def queued(self) -> int:
        """Count the jobs that wait."""
        return self.store.jobs.counts()[JobState.QUEUED]

    def fill(self, length: int) -> None:
        """Fill the queue to that number: add the missing rows, copies of a requested plan's, a second apart."""
        missing = length - self.queued()
        if missing <= 0:
            return
        database = self.store.database
        now = database.now()
        with database.write() as session:
            like = session.scalars(select(PlanRow).limit(1)).one().options
            numbers = [next(self._numbers) for _ in range(missing)]
            made = [now - timedelta(days=1) + timedelta(seconds=number) for number in numbers]
            names = [f"filled-{number}" for number in numbers]
            jobs = [
                {"id": name, "subject_id": name, "created_at": at, "kind": kinds.PLAN, "state": JobState.QUEUED}
                | {"short": True}
                for name, at in zip(names, made, strict=True)
            ]
            plans = [
                {"id": name, "job_id": name, "created_at": at, "options": like}
                | {"phantom_id": "l-shape", "scanner_id": self.scanner_id}
                for name, at in zip(names, made, strict=True)
            ]
            session.execute(insert(JobRow), jobs)
            session.execute(insert(PlanRow), plans)

    def finished_per_s(self, jobs: int, length: int) -> float:
        """Measure jobs finished a second, from the first end to the last awaited one, by the events' own times."""
        begun = self.store.events.newest_number()
        ended = select(func.count(), func.min(EventRow.at), func.max(EventRow.at))
        ended = ended.where(EventRow.number > begun, EventRow.type == event_kinds.SUCCEEDED)
        self.fill(length)
        deadline, wanted = time.monotonic() + WINDOW_S, min(jobs, length)
        while True:
            with self.store.database.read() as session:
                number, first, last = session.execute(ended).one()
            late = time.monotonic() > deadline
            if number >= wanted or (late and number > 1):
                return float((number - 1) / (last - first).total_seconds())
            if time.monotonic() > deadline + NOBODY_WORKS_S:
                raise SystemExit("the workers do not work: look at their log")
            time.sleep(0.02)

    def accepted_per_s(self, asks: int) -> float:
        """Measure jobs accepted a second from several concurrent clients."""
        started = time.perf_counter()
        with ThreadPoolExecutor(CLIENTS) as clients:
            list(clients.map(lambda _: self.ask(), range(CLIENTS * asks)))
        return CLIENTS * asks / (time.perf_counter() - started)

    def claim_ms(self, asks: int) -> float:
        """Measure the claim of one more worker, which gives its jobs back; the claim alone counts."""
        taken = []
        for _ in range(asks):
            started = time.perf_counter()
            claim = self.store.jobs.claim("study")
            taken.append(time.perf_counter() - started)
            if claim is not None:
                self.store.jobs.release(claim)
        return 1e3 * median(taken)

    def page_ms(self, asks: int, length: int, depth: float) -> float:
        """Measure a page of jobs behind this share of the queue."""
        after = {}
        if depth:
            with self.store.database.read() as session:
                oldest = select(JobRow.created_at, JobRow.id).order_by(JobRow.created_at, JobRow.id)
                at, name = session.execute(oldest.offset(int((1.0 - depth) * length)).limit(1)).one()
            after = {"after": f"{round(at.timestamp() * 1e6)}.{name}"}
        path = f"/v1/jobs?{urlencode({'limit': PAGE_JOBS, **after})}"
        return milliseconds(lambda: demo_client.get(self.client, path), asks)


def milliseconds(ask: Callable[[], object], times: int) -> float:
    """Take the median of some times, after one that fills caches."""
    ask()
    taken = []
    for _ in range(times):
        started = time.perf_counter()
        ask()
        taken.append(time.perf_counter() - started)
    return 1e3 * median(taken)
