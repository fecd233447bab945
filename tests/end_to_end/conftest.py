"""Real servers on free loopback ports, which nothing leave behind and which cannot reach the network."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from sawmill_worker.files.scan_writer import write_raw_scan
from sawmill_worker.tomography.built_in import L_SHAPE
from sawmill_worker.tomography.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_worker.tomography.log_model import SAPWOOD_PER_MM, LogModel
from sawmill_worker.tomography.simulate import simulate_stack

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=512, detector_pitch_mm=2.25)
THETA = Theta(0.7, 728.0, -254.0, -37.0, -0.21)
VIEWS, PHANTOM_ROWS, LOG_ROWS, ROW_PITCH_MM = 180, 2, 2, 3.0
START_S, STOP_S, JOB_S = 60.0, 25.0, 90.0

# Python imports this file at the start of every process that has its folder on PYTHONPATH.
GUARD = """
import ipaddress, os, socket

def local(address):
    if not isinstance(address, tuple):
        return True  # a Unix socket's path, or netlink
    try:
        return ipaddress.ip_address(address[0]).is_loopback
    except ValueError:
        return address[0] in ("", "localhost")

def refuse(address):
    with open(os.environ["NETWORK_ASKED_FOR"], "a") as log:
        log.write(f"{address}\\n")
    raise PermissionError(f"the network was asked for: {address}")

class Guarded(socket.socket):
    def connect(self, address):
        return super().connect(address) if local(address) else refuse(address)
    def connect_ex(self, address):
        return super().connect_ex(address) if local(address) else refuse(address)
    def sendto(self, data, *rest):
        return super().sendto(data, *rest) if local(rest[-1]) else refuse(rest[-1])
    def bind(self, address):
        return super().bind(address) if local(address) else refuse(address)

find = socket.getaddrinfo
def getaddrinfo(host, *rest, **options):
    return find(host, *rest, **options) if local((host,)) else refuse((host,))

socket.socket, socket.getaddrinfo = Guarded, getaddrinfo
"""


@dataclass
class Offline:
    """An environment in which every process notes and refuses what would leave this machine."""

    folder: Path
    variables: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        (self.folder / "sitecustomize.py").write_text(GUARD)
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        paths = os.pathsep.join(filter(None, (str(self.folder), kept.get("PYTHONPATH"))))
        self.variables = {**kept, "PYTHONPATH": paths, "NETWORK_ASKED_FOR": str(self._log)}

    @property
    def _log(self) -> Path:
        return self.folder / "asked"

    def asked_for(self) -> str:
        return self._log.read_text() if self._log.exists() else ""


@pytest.fixture(scope="module")
def offline(tmp_path_factory: pytest.TempPathFactory) -> Offline:
    return Offline(tmp_path_factory.mktemp("offline"))


@dataclass
class Service:
    """A running service as its clients see it, and its data folder."""

    client: httpx.Client
    data: Path
    process_id: int

    def get(self, path: str, **options: Any) -> httpx.Response:
        return self._answered(self.client.get(path, **options))

    def post(self, path: str, **options: Any) -> dict[str, Any]:
        return self._answered(self.client.post(path, **options)).json()

    def create_scanner(self, scanner: Scanner = SCANNER, name: str = "Line 2") -> str:
        return self.post("/v1/scanners", json={"name": name, "constants": vars(scanner)})["id"]

    def upload(self, content: Any, **spec: str) -> dict[str, Any]:
        return self.post("/v1/scans", params=spec, content=content)

    def wait(self, job_id: str) -> dict[str, Any]:
        deadline = time.monotonic() + JOB_S
        while time.monotonic() < deadline:
            job = self.get(f"/v1/jobs/{job_id}").json()
            if job["state"] in {"succeeded", "failed", "cancelled"}:
                return job
            time.sleep(0.05)
        raise AssertionError(f"job {job_id} did not end: {job}")

    @staticmethod
    def _answered(response: httpx.Response) -> httpx.Response:
        assert response.is_success, f"{response.request.url}: {response.status_code} {response.text}"
        return response


def descendants(process_id: int) -> set[int]:
    """Of a process: its children, theirs, and so on, as they are now."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            continue
    found, new = set[int](), {process_id}
    while new:
        found |= new
        new = {child for child, parent in parents.items() if parent in new} - found
    return found


def running(process_id: int) -> bool:
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@contextmanager
def process(command: list[str], environment: dict[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a server; at the end ask it to stop, and see that it leaves no process behind."""
    with log.open("wb") as sink, subprocess.Popen(command, stdout=sink, stderr=sink, env=environment) as started:
        try:
            yield started
        finally:
            family = descendants(started.pid)
            started.send_signal(signal.SIGTERM)
            try:
                started.wait(STOP_S)
            finally:
                left = {member for member in family if running(member)}
                for member in left:
                    os.kill(member, signal.SIGKILL)
    assert not left, f"still running after the end of {command}: {left}\n{log.read_text()[-3000:]}"


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@contextmanager
def serving(folder: Path, environment: dict[str, str], *flags: str, prefix: Sequence[str] = ()) -> Iterator[Service]:
    """`sawmill serve` with a data folder of its own, once it is ready; `prefix` is a command that becomes it."""
    port, data, log = free_port(), folder / "data", folder / "service.log"
    serve = [sys.executable, "-m", "sawmill_service.cli", "serve", "--data", str(data), "--port", str(port), *flags]
    command = [*prefix, *serve]
    address = f"http://127.0.0.1:{port}"
    with (
        process(command, environment, log) as server,
        httpx.Client(base_url=address, timeout=30, trust_env=False) as client,
    ):
        wait_until_ready(client, server, log)
        yield Service(client, data, server.pid)


@pytest.fixture(scope="session")
def serve() -> Callable[..., AbstractContextManager[Service]]:
    """Start a service of the test's own: as `serving`."""
    return serving


def wait_until_ready(client: httpx.Client, server: "subprocess.Popen[bytes]", log: Path) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        assert server.poll() is None, log.read_text()
        try:
            if client.get("/health/ready").is_success:
                return
        except httpx.TransportError:
            time.sleep(0.05)
    raise AssertionError(log.read_text())


@contextmanager
def celery_worker(folder: Path, environment: dict[str, str]) -> Iterator[None]:
    command = [sys.executable, "-m", "celery", "-A", "sawmill_worker.execution.celery_app", "worker"]
    with process(command, environment, folder / "celery.log"):
        yield


@pytest.fixture(params=["embedded", "celery"])
def engine(request: pytest.FixtureRequest, tmp_path: Path, offline: Offline) -> Iterator[Service]:
    """A service on each engine in turn: with workers of its own, and with a Celery worker woken through Redis."""
    with ExitStack() as stack:
        environment = offline.variables
        if request.param == "celery":
            redis_url: str = request.getfixturevalue("redis_url")
            environment = {
                **environment,
                "SAWMILL_BROKER_URL": redis_url,
                "SAWMILL_DATA_FOLDER": str(tmp_path / "data"),
            }
            stack.enter_context(celery_worker(tmp_path, environment))
        yield stack.enter_context(serving(tmp_path, environment, "--no-examples"))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    """One embedded service for a module's tests, with its examples."""
    with serving(tmp_path_factory.mktemp("live"), offline.variables) as service:
        yield service


@dataclass(frozen=True)
class MillScan:
    """A stack of counts as a mill takes it, and what is true of it."""

    path: Path
    scanner: Scanner
    theta: Theta
    log_image: np.ndarray


@pytest.fixture(scope="session")
def write_phantom_scan() -> Callable[..., None]:
    """Write a scan of the phantom alone, taken with a geometry."""

    def write(path: Path, theta: Theta, *, views: int = 60, seed: int = 3) -> None:
        write_stack(path, [L_SHAPE.of_density(SAPWOOD_PER_MM)], theta, views=views, seed=seed)

    return write


def write_stack(path: Path, slices: list[Any], theta: Theta, *, views: int, seed: int) -> None:
    angles = (np.arange(views) + 0.5) * 2 * np.pi / views
    stack = simulate_stack(slices, FanBeamGeometry(SCANNER, theta, angles), seed=seed)
    write_raw_scan(
        path,
        counts=stack.counts,
        flats=stack.flats,
        darks=stack.darks,
        angles_rad=angles,
        detector_pitch_mm=SCANNER.detector_pitch_mm,
        row_pitch_mm=ROW_PITCH_MM,
    )


@pytest.fixture(scope="session")
def mill_scan(tmp_path_factory: pytest.TempPathFactory) -> MillScan:
    """A log with the phantom on its sawn end: phantom rows, then log rows."""
    path = tmp_path_factory.mktemp("mill") / "stack.h5"
    log = LogModel.random(41)
    wood = L_SHAPE.of_density(SAPWOOD_PER_MM).moved(-4.0, 2.5)
    pieces = [log.slice_at(150.0 + ROW_PITCH_MM * row) for row in range(LOG_ROWS)]
    write_stack(path, [wood] * PHANTOM_ROWS + pieces, THETA, views=VIEWS, seed=41)
    return MillScan(path, SCANNER, THETA, pieces[0].rasterise(256, 400.0))


@pytest.fixture
def events() -> Callable[[Service, str], list[dict[str, Any]]]:
    """What a job's stream of server-sent events tells until its end."""

    def follow(service: Service, job_id: str) -> list[dict[str, Any]]:
        reported: list[dict[str, Any]] = []
        with service.client.stream("GET", f"/v1/jobs/{job_id}/events", timeout=JOB_S) as response:
            assert response.headers["content-type"].startswith("text/event-stream")
            name = ""
            for line in response.iter_lines():
                if line.startswith("event: "):
                    name = line.removeprefix("event: ")
                elif line.startswith("data: ") and name == "job":
                    reported.append(json.loads(line.removeprefix("data: ")))
                elif line.startswith("data: ") and name == "end":
                    return reported
        raise AssertionError("the stream ended without its event `end`")

    return follow
