"""A trial from start to end, with the servers that it needs."""

import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from random import Random
from typing import Any, Self

from tests.faults.audit import Audit
from tests.faults.catalogue import Engine, Fault
from tests.faults.clocks import Clocks
from tests.faults.processes import marked
from tests.faults.product import LONGEST_STOP_S, Product
from tests.faults.servers import NotHere, Postgres, Redis
from tests.faults.trial import Counts, Trial, count, disturbed, settle
from tests.faults.work import MIX, Asker


@dataclass(frozen=True)
class Request:
    """A trial to be run; `seed` decides the time and the target of each fault."""

    engine: Engine
    fault: Fault
    jobs: int
    seed: str
    mix: Sequence[str] = MIX
    long: bool = False
    workers: int = 2

    @property
    def most_faults(self) -> int:
        """More might leave a job no time to end."""
        return max(2, self.jobs // self.fault.jobs_a_fault)


@dataclass(frozen=True)
class Outcome:
    """A trial's counts, or why there are none: what it needs is not here, or the harness or the product broke down."""

    engine: str
    fault: str
    counts: Counts | None = None
    happened: dict[str, int] = field(default_factory=dict)
    skipped: str = ""
    broken: str = ""

    @classmethod
    def of(cls, document: dict[str, Any]) -> Self:
        """Read an outcome from the document that `as_json` writes."""
        counts = document["counts"] and Counts(**document["counts"])
        return cls(**document | {"counts": counts})

    @property
    def sound(self) -> bool:
        """True if nothing is wrong, as far as the trial went."""
        return not self.broken and (self.counts is None or self.counts.sound)

    def as_json(self) -> dict[str, Any]:
        """Return the whole outcome as JSON."""
        return asdict(self)


@dataclass
class Places:
    """Folders and servers of a run; a server starts when it is first needed."""

    folder: Path
    stack: ExitStack
    _postgres: Postgres | None = None

    def postgres(self) -> Postgres:
        """Return the one server of all trials, started when first needed."""
        if self._postgres is None:
            self._postgres = Postgres(self.folder / "postgresql")
            self._postgres.start()
            self.stack.callback(self._postgres.end, crash=False)
        return self._postgres


def try_one(places: Places, request: Request, right: dict[str, str], tick: Callable[[], None]) -> Outcome:
    """Start, ask, disturb, count; a trial that breaks down keeps no other from being made."""
    started = time.monotonic()
    names = request.engine.name, request.fault.name
    try:
        with trial_of(places, request) as trial:
            if request.fault.begin:
                request.fault.begin(trial)
            disturbed(trial, request.fault.disturb, request.jobs, tick)
            if request.fault.finish:
                request.fault.finish(trial)
            settle(trial)
            counts = count(trial, right, started)
    except NotHere as reason:
        return Outcome(*names, skipped=str(reason))
    except Exception:  # noqa: BLE001 - it is reported with the rest
        return Outcome(*names, broken=traceback.format_exc())
    counts.details.extend(trial.wrong)
    return Outcome(*names, counts, dict(trial.happened + trial.seen))


@contextmanager
def trial_of(places: Places, request: Request) -> Iterator[Trial]:
    """Start the product with everything that its faults need; at the end stop it, in time and completely."""
    engine, fault = request.engine, request.fault
    folder = places.folder / f"{engine.name}-{fault.name}"
    folder.mkdir(parents=True, exist_ok=True)
    clocks = Clocks(folder / "clocks") if fault.clocks else None
    variables = {"SAWMILL_WORKERS": str(request.workers), **(clocks.variables if clocks else {})}
    with ExitStack() as stack:
        postgres = places.postgres() if engine.postgres else None
        if postgres:
            variables["SAWMILL_DATABASE_URL"] = postgres.new_database(folder.name)
        redis = _redis(folder, stack) if engine.celery else None
        if redis:
            variables["SAWMILL_BROKER_URL"] = redis.url
        product = Product(folder, variables, services=fault.services, broker=engine.celery)
        url = variables.get("SAWMILL_DATABASE_URL", f"sqlite:///{product.data}/sawmill.db")
        if fault.before:
            fault.before(product.data, url)
        stack.callback(product.end)
        product.start()
        audit = Audit(url)
        stack.callback(audit.close)
        audit.install()
        asker = Asker(product.client, 900.0 if request.long else 120.0)
        rng = Random(request.seed)  # noqa: S311
        trial = Trial(product, audit, asker, rng, request.most_faults, request.mix, request.long)
        trial.redis, trial.postgres, trial.clocks = redis, postgres, clocks
        asker.prepare()
        yield trial
        taken_s = product.end()
        if taken_s > LONGEST_STOP_S:
            trial.wrong.append(f"the last stop took {taken_s:.0f} s")
        if left := marked(product.world):
            trial.wrong.append(f"{len(left)} processes are left over")


def _redis(folder: Path, stack: ExitStack) -> Redis:
    redis = Redis(folder / "redis")
    redis.start()
    stack.callback(redis.kill)
    return redis
