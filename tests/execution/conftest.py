"""A store with jobs to run, and processes that run them without science."""

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec
from sawmill_platform.attempts import runner as runners
from sawmill_platform.attempts.runner import Runner
from sawmill_platform.attempts.template import Template
from sawmill_platform.contracts.jobs import Job, Priority
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

HERE = Path(__file__).parent
WITHOUT_KERNELS = "from sawmill_worker import attempt; attempt.running.warm_up = lambda: None; attempt.main()"


@pytest.fixture
def storage(tmp_path: Path) -> StorageSettings:
    return StorageSettings(data_folder=tmp_path / "data", database_url=None)


@pytest.fixture
def store(storage: StorageSettings, empty_data: Path) -> Iterator[Store]:
    shutil.copytree(empty_data, storage.data_folder)
    opened = Store(storage)
    yield opened
    opened.close()


@pytest.fixture
def settings(request: pytest.FixtureRequest) -> ExecutionSettings:
    """The product's, made quick; the parameter is whether attempts are forked."""
    return ExecutionSettings(
        lease_s=2,
        heartbeat_s=0.2,
        progress_s=0.05,
        poll_s=0.05,
        housekeeping_s=0.2,
        sweep_s=0.5,
        stop_grace_s=1,
        loss_wait_s=0,
        outage_wait_s=0,
        kill_grace_s=0.3,
        spare_processes=1,
        fork_attempts=getattr(request, "param", True),
        broker_url=None,
        memory_limit_bytes=2**29,
    )


@pytest.fixture
def command() -> list[str]:
    return [sys.executable, str(HERE / "fake_science.py")]


@pytest.fixture
def queue(store: Store) -> Callable[..., Job]:
    """Queue a job that behaves as asked."""
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=constants))

    def accept(behaviour: str, *, priority: Priority = Priority.WAITED_FOR) -> Job:
        spec = ScanSpec(scanner_id=scanner.id, data=DataKind.COUNTS)
        received = store.files.receive([behaviour.encode()], max_bytes=100)
        scan = store.scans.accept(spec, received, priority=priority)
        return store.jobs.get(scan.job_id)

    return accept


@pytest.fixture
def wait_for() -> Callable[[Callable[[], bool]], None]:
    def wait(condition: Callable[[], bool], timeout_s: float = 120.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, "waited in vain"
            time.sleep(0.05)

    return wait


@pytest.fixture
def stop() -> threading.Event:
    return threading.Event()


class LentTemplate(Template):
    """One that outlives the runner that starts attempts with it."""

    def close(self) -> None:
        """By whoever lends it."""


@pytest.fixture(scope="session")
def templates_to_lend() -> Iterator[dict[Any, LentTemplate]]:
    """By command and environment: what a runner would give a template of its own."""
    made: dict[Any, LentTemplate] = {}
    yield made
    for each in made.values():
        Template.close(each)


@pytest.fixture(autouse=True)
def lent_templates(templates_to_lend: dict[Any, LentTemplate], monkeypatch: pytest.MonkeyPatch) -> None:
    """Runners borrow templates: to import everything takes a second, and few tests are about it."""

    def lend(command: Sequence[str], environment: Mapping[str, str], tbb: Path) -> LentTemplate:
        asked = (tuple(command), frozenset(environment.items()), tbb)
        if asked not in templates_to_lend:
            templates_to_lend[asked] = LentTemplate(command, environment, tbb)
        return templates_to_lend[asked]

    monkeypatch.setattr(runners, "Template", lend)


@pytest.fixture
def own_templates(lent_templates: None, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ARG001 - after it
    """For tests of the template itself, of what it reaches and of what it logs."""
    monkeypatch.setattr(runners, "Template", Template)


@pytest.fixture
def runner(
    store: Store,
    settings: ExecutionSettings,
    stop: threading.Event,
    command: list[str],
) -> Iterator[Runner]:
    made = Runner(store, settings, stop, command=command)
    yield made
    made.close()


@pytest.fixture
def reader(
    store: Store,
    settings: ExecutionSettings,
    stop: threading.Event,
    own_templates: None,  # noqa: ARG001 - what it logs is read
) -> Iterator[Runner]:
    """With the science but the kernels, which reading does not need, and the memory that is allowed by default."""
    by_default = settings.model_copy(update={"memory_limit_bytes": None})
    made = Runner(store, by_default, stop, command=[sys.executable, "-c", WITHOUT_KERNELS])
    yield made
    made.close()


@pytest.fixture
def start(
    store: Store,
    settings: ExecutionSettings,
    command: list[str],
) -> Iterator[Callable[..., Runner]]:
    """Make a runner with settings of its own."""
    made = []

    def begin(**changed: Any) -> Runner:
        made.append(Runner(store, settings.model_copy(update=changed), threading.Event(), command=command))
        return made[-1]

    yield begin
    for each in made:
        each.close()


@pytest.fixture
def in_background() -> Iterator[Callable[..., Future[Any]]]:
    with ThreadPoolExecutor(4) as pool:
        yield pool.submit


def running(process_id: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


@pytest.fixture
def is_running() -> Callable[[int], bool]:
    return running
