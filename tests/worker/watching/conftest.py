"""A service that answers on a loopback port in this process, and folders that are watched."""

import json
import os
import queue
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from results import answer_of
from watching_process import no_progress

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import Scan
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.settings import StorageSettings
from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store
from sawmill_worker.watching.command import watch

BAD = b"no scan"


@dataclass
class Running:
    """The service, and a worker that refuses what begins with `BAD`."""

    store: Store
    settings: ServiceSettings
    url: str = ""
    reads: threading.Event = field(default_factory=threading.Event)
    reads_before_answers: bool = False
    queued: queue.SimpleQueue[str | None] = field(default_factory=queue.SimpleQueue)

    def create_scanner(self) -> str:
        constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=8, detector_pitch_mm=1.5)
        return self.store.scanners.create(ScannerSpec(name="Line 2", constants=constants)).id

    def content(self, scan: Scan) -> bytes:
        return (self.store.files.folder / "uploads/scans" / scan.id / "original").read_bytes()

    def wake(self, job_id: str) -> None:
        """Let the worker read a scan; where `reads_before_answers` says so, the scan's sender waits for that."""
        self.queued.put(job_id)
        while self.reads_before_answers and not self.store.jobs.get(job_id).state.ended:
            time.sleep(0.005)

    def work(self) -> None:
        """Read scans without any science, while `reads` is set, until null is queued."""
        while self.queued.get() is not None:
            self.reads.wait()
            claim = self.store.jobs.claim("test")
            if claim is None:  # its job was cancelled
                continue
            scan = self.store.scans.get(self.store.jobs.get(claim.job_id).subject_id)
            if self.content(scan).startswith(BAD):
                failure = Failure(kind=FailureKind.INPUT, code="unknown-format", detail="the file is no scan")
                self.store.jobs.fail(claim, failure)
                continue
            output = self.store.files.make_attempt_folder(claim.job_id, claim.attempt)
            shape = {"views": 3, "rows": 1, "detector": 8}
            reading = {"format": "npy", "shape": shape, "angular_range_deg": (0.0, 240.0)}
            self.store.jobs.succeed(claim, answer_of(claim.job.kind, reading), output)


@pytest.fixture(scope="session")
def place() -> Iterator[Path]:
    """In memory, where there is such a file system: hundreds of commits take no time, and a kill is no power cut."""
    memory = "/dev/shm"  # noqa: S108 - a folder of its own in it
    with tempfile.TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None) as folder:
        yield Path(folder)


@pytest.fixture(scope="session")
def running(place: Path, empty_data: Path) -> Iterator[Running]:
    shutil.copytree(empty_data, place / "data")
    store = Store(StorageSettings(data_folder=place / "data", database_url=None))
    settings = ServiceSettings(max_upload_bytes=100_000, change_rate_limit="100000/minute", rate_limit="100000/minute")
    service = Running(store, settings)
    config = uvicorn.Config(create_app(settings, store, service.wake), port=0, ws="none", log_config=None)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.005)
    port = server.servers[0].sockets[0].getsockname()[1]
    service.url = f"http://127.0.0.1:{port}"
    service.reads.set()
    worker = threading.Thread(target=service.work)
    worker.start()
    yield service
    service.reads.set()
    service.queued.put(None)
    server.should_exit = True
    worker.join()
    thread.join()
    store.close()


def toml(value: Any) -> str:
    """Write a value in one line of TOML."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {toml(each)}' for name, each in value.items())}}}"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


@dataclass
class Watched:
    """A folder, and the file of settings that names it."""

    running: Running
    scanner_id: str
    folder: Path
    settings: Path
    document: dict[str, Any]

    def scans(self) -> list[Scan]:
        """Of the folder's scanner, the oldest first."""
        return self.running.store.scans.page(scanner_id=self.scanner_id, limit=100).items[::-1]

    def contents(self) -> dict[str, bytes]:
        """Of all its scans, whose names are all different."""
        scans = self.scans()
        assert len({scan.name for scan in scans}) == len(scans)
        return {scan.name: self.running.content(scan) for scan in scans}

    def describe(self, **changes: Any) -> None:
        """Write the settings with other values of the folder."""
        document = self.document | {"folders": [self.document["folders"][0] | changes]}
        lines = [f"{name} = {toml(value)}\n" for name, value in document.items()]
        self.settings.write_text("".join(lines))

    def put(self, name: str, content: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content)
        return path

    def once(self) -> bool:
        return watch(self.settings, no_progress, once=True)

    def ended(self, place: str) -> dict[str, bytes]:
        """Names and contents of the files in `done/` or `refused/`, without what is beside them or half written."""
        found = {path.name: path for path in (self.folder / place).glob("*/*")}
        beside = (".json", ".reason.txt", ".part")
        return {name: path.read_bytes() for name, path in found.items() if not name.endswith(beside)}

    def note(self, name: str) -> dict[str, Any]:
        (path,) = (self.folder / "done").glob(f"*/{name}.json")
        return json.loads(path.read_text())

    def reason(self, name: str) -> str:
        (path,) = (self.folder / "refused").glob(f"*/{name}.reason.txt")
        return path.read_text()

    def records(self) -> list[Path]:
        return list((self.folder / "taken").glob("*.json"))

    def left(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir() if path.is_file())


@pytest.fixture
def watched(place: Path, running: Running) -> Iterator[Watched]:
    scanner_id = running.create_scanner()
    folder = place / scanner_id
    folder.mkdir()
    files = [
        {"match": "phantom*.npy", "data": "line-integrals", "angles_deg": "0:120", "phantom_id": "l-shape"},
        {"match": "*.npy", "data": "line-integrals", "angles_deg": "0:120", "priority": "batch"},
    ]
    described = {"folder": str(folder), "scanner_id": scanner_id, "still_for_s": 0.03, "files": files}
    document = {"service": running.url, "poll_s": 0.02, "folders": [described]}
    made = Watched(running, scanner_id, folder, place / f"{scanner_id}.toml", document)
    made.describe()
    yield made
    running.reads_before_answers = False


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Wait for something to become true."""

    def wait(true: Callable[[], object], within_s: float = 120.0) -> None:
        deadline = time.monotonic() + within_s
        while not true():
            assert time.monotonic() < deadline
            time.sleep(0.005)

    return wait
