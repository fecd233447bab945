"""All trials of a run, one after the other."""

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from faults.audit import Audit
from faults.catalogue import Engine, Fault, cannot_mount, mounting
from faults.clocks import Clocks
from faults.processes import marked
from faults.product import LONGEST_STOP_S, Product
from faults.servers import NotHere, Postgres, Redis
from faults.trial import Counts, Trial, count, disturbed
from faults.work import BASE, MIX, PLANS, Asker, answer_of

FEWEST_JOBS = 6  # of a trial


@dataclass(frozen=True)
class Plan:
    """What a run tries; `folder` keeps data and logs."""

    faults: Sequence[Fault]
    engines: Sequence[Engine]
    jobs: int
    seed: int
    long: bool = False
    folder: Path | None = None
    mix: Sequence[str] = MIX

    @property
    def trials(self) -> list[tuple[Engine, Fault]]:
        """One for each engine and each fault that it can have."""
        return [(engine, fault) for engine in self.engines for fault in self.faults if fault.on(engine)]


@dataclass(frozen=True)
class Outcome:
    """A trial's counts, or why there was none."""

    engine: str
    fault: str
    counts: Counts | None = None
    happened: Counter[str] = field(default_factory=Counter)
    skipped: str = ""

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong, as far as it was tried."""
        return self.counts is None or self.counts.sound

    def as_json(self) -> dict[str, Any]:
        """Everything."""
        return asdict(self)


def conduct_all(plan: Plan) -> list[Outcome]:
    """The right answers first, then the trials."""
    bar = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with ExitStack() as stack:
        folder = plan.folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-faults-")))
        folder.chmod(0o755)  # PostgreSQL runs as somebody else
        folder = (folder / f"run-{int(time.time())}").absolute()
        places = Places(folder, stack)
        shares = _shares(plan)
        progress = stack.enter_context(Progress(*bar, console=Console(stderr=True)))
        task = progress.add_task("right answers", total=sum(shares))

        def tick() -> None:
            progress.advance(task)

        right = right_answers(places, plan)
        outcomes = []
        for number, ((engine, fault), jobs) in enumerate(zip(plan.trials, shares, strict=True)):
            progress.update(task, description=f"{engine.name}: {fault.name}")
            outcomes.append(try_one(places, plan, number, engine, fault, jobs, right, tick))
        return outcomes


def _shares(plan: Plan) -> list[int]:
    """Of the jobs, for each trial."""
    trials = max(1, len(plan.trials))
    return [max(FEWEST_JOBS, (plan.jobs + number) // trials) for number in range(len(plan.trials))]


@dataclass
class Places:
    """Folders and servers of a run; a server starts when it is first needed."""

    folder: Path
    stack: ExitStack
    _postgres: Postgres | None = None

    def postgres(self) -> Postgres:
        """The one server of all trials."""
        if self._postgres is None:
            self._postgres = Postgres(self.folder / "postgresql")
            self._postgres.start()
            self.stack.callback(self._postgres.end, crash=False)
        return self._postgres


def right_answers(places: Places, plan: Plan) -> dict[str, str]:
    """What each kind of work is answered with when nothing happens."""
    engine = Engine("embedded-sqlite", celery=False, postgres=False)
    quiet = Fault("none", lambda _: None)
    with _trial(places, plan, engine, quiet, Random(0), most=0) as trial:  # noqa: S311
        for number in range(PLANS):
            trial.asker.ask("plan", number)
        for name in sorted(set(plan.mix) - {"plan", *BASE}):
            trial.asker.ask(name)
        disturbed(trial, None, 0, lambda: None)
        client, data = trial.product.client, trial.product.data
        return {accepted.work.name: answer_of(client, data, accepted) for accepted in trial.asker.accepted}


def try_one(
    places: Places,
    plan: Plan,
    number: int,
    engine: Engine,
    fault: Fault,
    jobs: int,
    right: dict[str, str],
    tick: Callable[[], None],
) -> Outcome:
    """One trial from start to end."""
    started = time.monotonic()
    rng = Random(f"{plan.seed} {number} {engine.name} {fault.name}")  # noqa: S311
    try:
        with _trial(places, plan, engine, fault, rng, most=max(2, jobs // fault.jobs_a_fault)) as trial:
            if fault.begin:
                fault.begin(trial)
            disturbed(trial, fault.disturb, jobs, tick)
            if fault.finish:
                fault.finish(trial)
            counts = count(trial, right, started)
    except NotHere as reason:
        return Outcome(engine.name, fault.name, skipped=str(reason))
    counts.details.extend(sentence for sentence in trial.wrong if sentence not in counts.details)
    return Outcome(engine.name, fault.name, counts, trial.happened)


@contextmanager
def _trial(places: Places, plan: Plan, engine: Engine, fault: Fault, rng: Random, *, most: int) -> Iterator[Trial]:
    """The product, started, with everything that its faults need."""
    folder = places.folder / f"{engine.name}-{fault.name}"
    folder.mkdir(parents=True)
    variables: dict[str, str] = {}
    prefix: list[str] = []
    clocks = Clocks(folder / "clocks") if fault.clocks else None
    if fault.small_disk:
        if reason := cannot_mount(folder / "data"):
            raise NotHere(f"no disk can be mounted here: {reason}")
        prefix = mounting(folder / "data")
    with ExitStack() as stack:
        postgres, redis = None, None
        if clocks:
            variables |= clocks.variables
        if engine.postgres:
            postgres = places.postgres()
            variables["SAWMILL_DATABASE_URL"] = postgres.new_database(f"{fault.name}-{engine.name}")
        if engine.celery:
            redis = Redis(folder / "redis")
            redis.start()
            stack.callback(redis.kill)
            variables["SAWMILL_BROKER_URL"] = redis.url
        product = Product(folder, variables, services=fault.services, broker=engine.celery, prefix=prefix)
        url = variables.get("SAWMILL_DATABASE_URL", f"sqlite:///{product.data_here}/sawmill.db")
        if fault.before:
            fault.before(product.data_here, url)
        stack.callback(product.end)
        product.start()
        if fault.small_disk:
            url = f"sqlite:///{product.data}/sawmill.db"
        audit = Audit(url)
        stack.callback(audit.close)
        audit.install()
        asker = Asker(product.client, 900.0 if plan.long else 120.0)
        trial = Trial(product, audit, asker, rng, most, plan.mix, plan.long, redis, postgres, clocks)
        asker.prepare()
        yield trial
        taken_s = product.end()
        if taken_s > LONGEST_STOP_S:
            trial.wrong.append(f"the last stop took {taken_s:.0f} s")
        if left := marked(product.world):
            trial.wrong.append(f"{len(left)} processes are left over")
