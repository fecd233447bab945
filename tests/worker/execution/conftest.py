"""A store with jobs to run, and processes that run them without science."""

import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from live_service import wait_until
from results import SCANNER_SPEC

from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts.process import AttemptProcess, AttemptStarter
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.contracts.jobs import Job, Priority
from sawmill_platform.contracts.kind_declarations import SHORT_UPLOAD_BYTES
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.program import WorkerProgram, attempt_environment, attempt_starter
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.store import Store
from sawmill_store.subjects.mill_subjects import MILL_SUBJECTS
from sawmill_vocabulary import DataKind
from sawmill_worker.program import MILL

HERE = Path(__file__).parent


@pytest.fixture
def storage(tmp_path: Path) -> StorageSettings:
    return StorageSettings(data_folder=tmp_path / "data", database_url=None)


@pytest.fixture
def store(storage: StorageSettings, empty_data: Path) -> Iterator[Store]:
    shutil.copytree(empty_data, storage.data_folder)
    with closing(Store(storage)) as opened:
        yield opened


@pytest.fixture
def store_with(store: Store) -> Iterator[Callable[[type[Jobs]], Store]]:
    """Open a second store on the same rows and files, whose jobs have a fault, for a worker."""
    with ExitStack() as opened:

        def begin(jobs: type[Jobs]) -> Store:
            faulty = opened.enter_context(closing(Store(store.settings)))
            faulty.jobs = jobs(faulty.database, faulty.files, MILL_SUBJECTS)
            return faulty

        yield begin


@pytest.fixture
def settings(request: pytest.FixtureRequest) -> ExecutionSettings:
    """The product's, made quick; the parameter is whether attempts are forked."""
    waits = {"lease_s": 2, "heartbeat_s": 0.2, "progress_s": 0.05, "poll_s": 0.05, "housekeeping_s": 0.2}
    waits |= {"sweep_s": 0.5, "stop_grace_s": 1, "loss_wait_s": 0, "outage_wait_s": 0, "kill_grace_s": 0.3}
    limits = {"spare_processes": 1, "broker_url": None, "memory_limit_bytes": 2**29}
    return ExecutionSettings(**waits, **limits, fork_attempts=getattr(request, "param", True))


@pytest.fixture
def command() -> list[str]:
    return [sys.executable, str(HERE / "fake_science.py")]


@pytest.fixture
def queue(store: Store) -> Callable[..., Job]:
    scanner = store.scanners.create(ScannerSpec.model_validate(SCANNER_SPEC))

    def accept(behaviour: str, *, priority: Priority = Priority.INTERACTIVE, short: bool = True) -> Job:
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
        received = store.files.receive([behaviour.encode()], max_bytes=100)
        if not short:  # the reading of a large file, which has a hole here
            received = replace(received, size_bytes=SHORT_UPLOAD_BYTES + 1)
            os.truncate(received.path, received.size_bytes)
        return store.jobs.get(store.scans.accept(spec, received, priority=priority).job_id)

    return accept


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


class Starter:
    """A starter of attempts that notes what it has started, and that may outlive the runner that uses it."""

    def __init__(self, starter: AttemptStarter, *, lent: bool) -> None:
        self.starter, self.lent, self.patience_s = starter, lent, starter.patience_s
        self.started: list[AttemptProcess] = []

    def start(self) -> AttemptProcess:
        self.started.append(self.starter.start())
        return self.started[-1]

    def close(self) -> None:
        if not self.lent:
            self.starter.close()


class Lender:
    """Starters by what they start: to import everything takes a second, and few tests are about that."""

    def __init__(self) -> None:
        self._made: dict[Any, AttemptStarter] = {}

    def lend(self, command: Sequence[str], store: Store, settings: ExecutionSettings) -> Starter:
        environment = frozenset(attempt_environment(store, settings).items())
        asked = (tuple(command), environment, settings.fork_attempts)
        if asked not in self._made:
            self._made[asked] = attempt_starter(command, store, settings)
        return Starter(self._made[asked], lent=True)

    def close(self) -> None:
        for each in self._made.values():
            each.close()


@pytest.fixture(scope="session")
def lender() -> Iterator[Lender]:
    with closing(Lender()) as made:
        yield made


@pytest.fixture
def attempts(request: pytest.FixtureRequest, lender: Lender, store: Store, command: list[str]) -> Callable[..., Any]:
    """Make a starter: a lent one, or its own where a test is about templates or what they log (`own_templates`)."""
    own = "own_templates" in request.fixturenames

    def make(settings: ExecutionSettings, command: Sequence[str] = command) -> Starter:
        if own:
            return Starter(attempt_starter(command, store, settings), lent=False)
        return lender.lend(command, store, settings)

    return make


@pytest.fixture
def own_templates() -> None:
    """For tests of the template itself, of what it reaches and of what it logs."""


@dataclass(frozen=True)
class LendingProgram(WorkerProgram[Store]):
    """The mill's program over tasks without science, whose workers borrow the starters of attempts."""

    lend: Callable[..., AttemptStarter]

    def attempts(self, store: Store, settings: ExecutionSettings) -> AttemptStarter:  # noqa: ARG002 - the fixture's
        return self.lend(settings)


@pytest.fixture
def program(attempts: Callable[..., Starter], command: list[str]) -> LendingProgram:
    return LendingProgram(MILL.open_store, MILL.housekeeping, command, attempts)


@pytest.fixture
def starter(settings: ExecutionSettings, attempts: Callable[..., Starter]) -> Starter:
    return attempts(settings)


@pytest.fixture
def runner(store: Store, settings: ExecutionSettings, stop: threading.Event, starter: Starter) -> Iterator[Runner]:
    with closing(Runner(store, settings, stop, attempts=starter)) as made:
        yield made


@pytest.fixture
def start(
    store: Store, settings: ExecutionSettings, stop: threading.Event, attempts: Callable[..., Starter]
) -> Iterator[Callable[..., Runner]]:
    with ExitStack() as made:

        def begin(on: Store = store, starter: AttemptStarter | None = None, **changed: Any) -> Runner:
            asked = settings.model_copy(update=changed)
            return made.enter_context(closing(Runner(on, asked, stop, attempts=starter or attempts(asked))))

        yield begin


@pytest.fixture
def in_background() -> Iterator[Callable[..., Future[Any]]]:
    with ThreadPoolExecutor(4) as pool:
        yield pool.submit


@pytest.fixture
def talk(store: Store, queue: Callable[..., Job], in_background: Callable[..., Any]) -> Callable[[Runner], Any]:
    def begin(runner: Runner) -> tuple[Job, Future[Any], int]:
        job, outcome = queue("talk"), in_background(runner.run_next)
        wait_until(lambda: any(store.files.folder.glob("attempts/*/pid")))
        return job, outcome, int(next(store.files.folder.glob("attempts/*/pid")).read_text())

    return begin
