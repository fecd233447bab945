"""The faults that are tried on each engine, and the trials of a run, one after the other, with their servers."""

import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from tests.faults import injections, upgrade
from tests.faults.audit import Audit
from tests.faults.processes import marked
from tests.faults.product import LONGEST_STOP_S, Product
from tests.faults.servers import NotHere, Postgres, Redis
from tests.faults.trial import Counts, Trial, count, disturbed, settle
from tests.faults.work import BASE, MIX, PLANS, Asker, answer_of

FEWEST_JOBS = 4  # in a trial


@dataclass(frozen=True)
class Engine:
    """An engine: the workers' software, and the database."""

    name: str
    celery: bool
    postgres: bool


ENGINES = (
    Engine("embedded-sqlite", celery=False, postgres=False),
    Engine("embedded-postgresql", celery=False, postgres=True),
    Engine("celery-sqlite", celery=True, postgres=False),
    Engine("celery-postgresql", celery=True, postgres=True),
)


@dataclass(frozen=True)
class Fault:
    """A class of faults, on the engines that can have it.

    `jobs_a_fault` is the least number of jobs for each fault. `before` is called with the data folder and the
    database's URL before the product starts for the first time, `begin` with the trial at the beginning.
    """

    name: str
    disturb: Callable[[Trial], None]
    on: Callable[[Engine], bool] = lambda _: True
    jobs_a_fault: int = 3
    before: Callable[[Path, str], None] | None = None
    begin: Callable[[Trial], None] | None = None


def _embedded(engine: Engine) -> bool:
    return not engine.celery


FAULTS = (
    Fault("kill", injections.kill, jobs_a_fault=2),
    Fault("stop", injections.stop, on=_embedded, jobs_a_fault=6),
    Fault("redis", injections.redis_trouble, on=lambda engine: engine.celery, jobs_a_fault=4),
    Fault("postgresql", injections.postgres_trouble, on=lambda engine: engine.postgres, jobs_a_fault=4),
    Fault("upgrade", injections.kill, on=_embedded, jobs_a_fault=6, before=upgrade.before, begin=upgrade.begin),
)


@dataclass(frozen=True)
class Plan:
    """The scope of a run; `folder` keeps data and logs, `seed` decides the time and the target of each fault."""

    faults: Sequence[Fault]
    engines: Sequence[Engine]
    jobs: int
    seed: int
    long: bool = False
    folder: Path | None = None
    mix: Sequence[str] = MIX
    workers: int = 2

    def pairs(self) -> list[tuple[Engine, Fault, int]]:
        pairs = [(engine, fault) for engine in self.engines for fault in self.faults if fault.on(engine)]
        shares = [max(FEWEST_JOBS, (self.jobs + number) // len(pairs)) for number in range(len(pairs))]
        return [(*pair, share) for pair, share in zip(pairs, shares, strict=True)]


@dataclass(frozen=True)
class Outcome:
    """A trial's counts, or why there are none: what it needs is not here, or the harness or the product broke down."""

    engine: str
    fault: str
    counts: Counts | None = None
    happened: dict[str, int] = field(default_factory=dict)
    skipped: str = ""
    broken: str = ""

    @property
    def sound(self) -> bool:
        """True if nothing is wrong, as far as the trial went."""
        return not self.broken and (self.counts is None or self.counts.sound)


@dataclass
class Places:
    """Folders and servers of a run; PostgreSQL starts when it is first needed."""

    folder: Path
    stack: ExitStack
    _postgres: Postgres | None = None

    def postgres(self) -> Postgres:
        if self._postgres is None:
            self._postgres = Postgres(self.folder / "postgresql")
            self._postgres.start()
            self.stack.callback(self._postgres.end, crash=False)
        return self._postgres

    def redis(self, folder: Path, stack: ExitStack) -> Redis:
        redis = Redis(folder / "redis")
        redis.start()
        stack.callback(redis.kill)
        return redis


def conduct_all(plan: Plan) -> Iterator[Outcome]:
    """Compute the right answers, then yield the outcomes of the trials as they end."""
    bar = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with ExitStack() as stack:
        folder = plan.folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-faults-")))
        folder.chmod(0o755)  # PostgreSQL runs as somebody else
        places = Places((folder / f"run-{int(time.time())}").absolute(), stack)
        progress = stack.enter_context(Progress(*bar, console=Console(stderr=True)))
        task = progress.add_task("right answers", total=sum(jobs for *_, jobs in plan.pairs()))
        right = right_answers(places, plan)
        for engine, fault, jobs in plan.pairs():
            progress.update(task, description=f"{engine.name}: {fault.name}")
            yield try_one(places, plan, (engine, fault, jobs), right, lambda: progress.advance(task))


def right_answers(places: Places, plan: Plan) -> dict[str, str]:
    """Compute the answer to each kind of work when no fault happens."""
    with trial_of(places, plan, ENGINES[0], Fault("none", lambda _: None), 0) as trial:
        for number in range(PLANS):
            trial.asker.ask("plan", number)
        for name in sorted(set(plan.mix) - {"plan", *BASE}):
            trial.asker.ask(name)
        settle(trial)
        client, data = trial.product.client, trial.product.data
        return {accepted.work.name: answer_of(client, data, accepted) for accepted in trial.asker.accepted}


def try_one(
    places: Places, plan: Plan, pair: tuple[Engine, Fault, int], right: dict[str, str], tick: Callable[[], None]
) -> Outcome:
    """Start, ask, disturb, count; a trial that breaks down keeps no other from being made."""
    started, (engine, fault, jobs) = time.monotonic(), pair
    try:
        with trial_of(places, plan, *pair) as trial:
            if fault.begin:
                fault.begin(trial)
            disturbed(trial, fault.disturb, jobs, tick)
            settle(trial)
            counts = count(trial, right, started)
    except NotHere as reason:
        return Outcome(engine.name, fault.name, skipped=str(reason))
    except Exception:  # noqa: BLE001 - it is reported with the rest
        return Outcome(engine.name, fault.name, broken=traceback.format_exc())
    counts.details.extend(trial.wrong)
    return Outcome(engine.name, fault.name, counts, dict(trial.happened))


@contextmanager
def trial_of(places: Places, plan: Plan, engine: Engine, fault: Fault, jobs: int) -> Iterator[Trial]:
    """Start the product with everything that its faults need; at the end stop it, in time and completely."""
    folder = places.folder / f"{engine.name}-{fault.name}"
    folder.mkdir(parents=True, exist_ok=True)
    variables = {"SAWMILL_WORKERS": str(plan.workers)}
    with ExitStack() as stack:
        postgres = places.postgres() if engine.postgres else None
        if postgres:
            variables["SAWMILL_DATABASE_URL"] = postgres.new_database(folder.name)
        redis = places.redis(folder, stack) if engine.celery else None
        if redis:
            variables["SAWMILL_BROKER_URL"] = redis.url
        product = Product(folder, variables, broker=engine.celery)
        url = variables.get("SAWMILL_DATABASE_URL", f"sqlite:///{product.data}/sawmill.db")
        if fault.before:
            fault.before(product.data, url)
        stack.callback(product.end)
        product.start()
        audit = Audit(url)
        stack.callback(audit.close)
        audit.install()
        asker = Asker(product.client, 900.0 if plan.long else 120.0)
        rng = Random(f"{plan.seed} {engine.name} {fault.name}")  # noqa: S311
        most = max(2, jobs // fault.jobs_a_fault)
        trial = Trial(product, audit, asker, rng, most, plan.mix, plan.long, redis, postgres)
        asker.prepare()
        yield trial
        taken_s = product.end()
        if taken_s > LONGEST_STOP_S:
            trial.wrong.append(f"the last stop took {taken_s:.0f} s")
        if left := marked(product.world):
            trial.wrong.append(f"{len(left)} processes are left over")
