"""A trial: the product on an engine, requested jobs, faults while they run, and the counts at the end."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from random import Random

from sqlalchemy.exc import DBAPIError
from tests.faults.audit import Audit, orphans
from tests.faults.product import Product
from tests.faults.servers import Postgres, Redis
from tests.faults.work import MIX, Asker, answer_of

MOST_WAITING = 8  # jobs requested ahead: enough that faults meet running ones
ENDED_S = 300.0  # limit for the jobs' ends once all are accepted and the faults are over
LULL_S = 5.0  # a fault comes although no job runs
SETTLED_S = 45.0  # limit for the removal of remains: detection, 5 s of grace, removal


@dataclass
class Trial:
    product: Product
    audit: Audit
    asker: Asker
    rng: Random
    most: int  # faults: with more a job might never have the time to end
    mix: Sequence[str] = MIX  # names of the jobs to request
    long: bool = False  # outages last as long as in an hour's run
    redis: Redis | None = None
    postgres: Postgres | None = None
    over: threading.Event = field(default_factory=threading.Event)  # every job has ended
    happened: Counter[str] = field(default_factory=Counter)  # injected faults
    wrong: list[str] = field(default_factory=list)  # faults of the product other than the four counts

    def again(self, shortest_s: float, longest_s: float) -> bool:
        """Wait a while, then for a job to run; return whether there is to be another fault."""
        if self.happened.total() >= self.most or self.over.wait(self.rng.uniform(shortest_s, longest_s)):
            return False
        _wait(LULL_S, lambda: self.over.is_set() or bool(self.holders()), look_s=0.03)
        return not self.over.wait(self.rng.uniform(0.0, 0.3))

    def holders(self) -> list[int]:
        with suppress(DBAPIError):
            return self.audit.holders()
        return []


@dataclass(frozen=True)
class Counts:
    """The counts of a trial; the first four must be 0."""

    lost: int
    double: int
    unequal: int
    orphans: int
    jobs: int
    faults: int
    losses: int
    seconds: float
    details: list[str]

    @property
    def sound(self) -> bool:
        return not (self.lost or self.double or self.unequal or self.orphans or self.details)


def ask_all(trial: Trial, jobs: int, progress: Callable[[], None]) -> None:
    """Request the mix in a random order, never far ahead of the ended jobs."""
    names = [trial.mix[number % len(trial.mix)] for number in range(jobs)]
    trial.rng.shuffle(names)
    for number, name in enumerate(names):
        while _unfinished(trial.audit) >= MOST_WAITING and not trial.over.is_set():
            time.sleep(0.2)
        if trial.over.is_set():  # the run was interrupted
            return
        trial.asker.ask(name, number)
        progress()


def disturbed(trial: Trial, fault: Callable[[Trial], None], jobs: int, progress: Callable[[], None]) -> None:
    """Request the jobs, disturb, and wait until all has ended."""
    with ThreadPoolExecutor(2) as threads:
        disturbing = threads.submit(fault, trial)
        asking = threads.submit(ask_all, trial, jobs, progress)
        try:
            asking.result()
            _wait_for_end(trial)
        finally:
            trial.over.set()
        disturbing.result()


def settle(trial: Trial) -> None:
    _wait_for_end(trial)
    trial.product.wait_until_ready()
    _wait(SETTLED_S, lambda: not orphans(trial.product.data, trial.audit.ledger().known))


def count(trial: Trial, right: dict[str, str], started: float) -> Counts:
    """Count lost, double, unequal and orphaned work, with the details."""
    ledger = trial.audit.ledger()
    # A job whose 202 a fault swallowed is in the database alone.
    states = {one.job_id: "not in the database" for one in trial.asker.accepted} | ledger.states
    lost = [f"job {job_id} {state}" for job_id, state in states.items() if state != "succeeded"]
    ended = [accepted for accepted in trial.asker.accepted if ledger.states.get(accepted.job_id) == "succeeded"]
    unequal = [
        f"unequal: {accepted.work.name}, job {accepted.job_id}"
        for accepted in ended
        if answer_of(trial.product.client, trial.product.data, accepted) != right[accepted.work.name]
    ]
    left = orphans(trial.product.data, ledger.known)
    details = [f"lost: {sentence}" for sentence in lost] + [f"double: {sentence}" for sentence in ledger.doubles]
    details += unequal + [f"orphan: {path}" for path in left]
    wrong = (len(found) for found in (lost, ledger.doubles, unequal, left))
    seconds = time.monotonic() - started
    return Counts(*wrong, len(ledger.states), trial.happened.total(), ledger.losses, seconds, details)


def _wait_for_end(trial: Trial) -> None:
    _wait(ENDED_S, lambda: _unfinished(trial.audit) == 0)


def _wait(longest_s: float, done: Callable[[], bool], *, look_s: float = 0.3) -> None:
    deadline = time.monotonic() + longest_s
    while time.monotonic() < deadline:
        if done():
            return
        time.sleep(look_s)


def _unfinished(audit: Audit) -> int:
    """Count the jobs that have not ended; many, while the database does not answer."""
    with suppress(DBAPIError):
        return audit.unfinished()
    return MOST_WAITING
