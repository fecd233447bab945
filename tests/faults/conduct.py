"""Runner of a run's trials, one after the other."""

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from tests.faults.catalogue import ENGINES, Engine, Fault
from tests.faults.small_disk import try_there
from tests.faults.trial import settle
from tests.faults.trials import Outcome, Places, Request, trial_of, try_one
from tests.faults.work import BASE, MIX, PLANS, answer_of

FEWEST_JOBS = 4  # in a trial


@dataclass(frozen=True)
class Plan:
    """The scope of a run; `folder` keeps data and logs."""

    faults: Sequence[Fault]
    engines: Sequence[Engine]
    jobs: int
    seed: int
    long: bool = False
    folder: Path | None = None
    mix: Sequence[str] = MIX
    workers: int = 2

    def requests(self) -> list[Request]:
        """List one request for each engine and each fault that it can have, with its share of the jobs."""
        pairs = [(engine, fault) for engine in self.engines for fault in self.faults if fault.on(engine)]
        return [
            Request(
                engine,
                fault,
                max(FEWEST_JOBS, (self.jobs + number) // len(pairs)),
                f"{self.seed} {engine.name} {fault.name}",
                self.mix,
                self.long,
                self.workers,
            )
            for number, (engine, fault) in enumerate(pairs)
        ]


def conduct_all(plan: Plan) -> Iterator[Outcome]:
    """Compute the right answers, then yield the outcomes of the trials as they end."""
    bar = (TextColumn("{task.description:<40}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    requests = plan.requests()
    with ExitStack() as stack:
        folder = plan.folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sawmill-faults-")))
        folder.chmod(0o755)  # PostgreSQL runs as somebody else
        places = Places((folder / f"run-{int(time.time())}").absolute(), stack)
        progress = stack.enter_context(Progress(*bar, console=Console(stderr=True)))
        task = progress.add_task("right answers", total=sum(request.jobs for request in requests))
        right = right_answers(places, plan)
        for request in requests:
            progress.update(task, description=f"{request.engine.name}: {request.fault.name}")
            if request.fault.small_disk:
                yield try_there(places.folder, request, right)
                progress.advance(task, request.jobs)
            else:
                yield try_one(places, request, right, lambda: progress.advance(task))


def right_answers(places: Places, plan: Plan) -> dict[str, str]:
    """Compute the answer to each kind of work when no fault happens."""
    nothing = Request(ENGINES[0], Fault("none", lambda _: None), 0, "0", workers=plan.workers)
    with trial_of(places, nothing) as trial:
        for number in range(PLANS):
            trial.asker.ask("plan", number)
        for name in sorted(set(plan.mix) - {"plan", *BASE}):
            trial.asker.ask(name)
        settle(trial)
        client, data = trial.product.client, trial.product.data
        return {accepted.work.name: answer_of(client, data, accepted) for accepted in trial.asker.accepted}
