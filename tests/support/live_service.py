"""Real servers on free loopback ports without the network, and other processes that hold a lock or race."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
from missing_parts import free_port

from sawmill_tomography.geometry.geometry import Scanner

SCANNER = Scanner(source_to_cor_mm=859.46, num_detector_pixels=512, detector_pitch_mm=2.25)
# Limits that only a hang reaches.
START_S, STOP_S, JOB_S, ANSWER_S = 120.0, 120.0, 240.0, 120.0
WAIT_S = 20  # in one answer

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

    def upload_phantom(self, content: bytes, scanner_id: str | None = None) -> dict[str, Any]:
        spec = {"scanner_id": scanner_id or self.create_scanner(), "data": "counts", "phantom_id": "l-shape"}
        return self.upload(content, **spec)

    def wait(self, job_id: str) -> dict[str, Any]:
        deadline = time.monotonic() + JOB_S
        while time.monotonic() < deadline:
            job = self.get(f"/v1/jobs/{job_id}", params={"wait": WAIT_S}).json()
            if job["state"] in {"succeeded", "failed", "cancelled"}:
                return job
        raise AssertionError(f"job {job_id} did not end: {job}")

    @staticmethod
    def _answered(response: httpx.Response) -> httpx.Response:
        assert response.is_success, f"{response.request.url}: {response.status_code} {response.text}"
        return response


def parents() -> dict[int, int]:
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(FileNotFoundError, ProcessLookupError):
            found[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    return found


def descendants(process_id: int) -> set[int]:
    """Of a process: its children, theirs, and so on, as they are now."""
    of, found, new = parents(), set[int](), {process_id}
    while new:
        found |= new
        new = {child for child, parent in of.items() if parent in new} - found
    return found


def workers(process_id: int) -> set[int]:
    found = set()
    for child in (child for child, parent in parents().items() if parent == process_id):
        with suppress(FileNotFoundError, ProcessLookupError):
            if b"sawmill_worker.poller" in Path(f"/proc/{child}/cmdline").read_bytes():
                found.add(child)
    return found


def stop_outside_a_transaction(worker: int, database: Path) -> None:
    """Stop a worker while it does not hold the lock for writing, which nobody else would get then."""
    while True:
        os.kill(worker, signal.SIGSTOP)
        with closing(sqlite3.connect(database, timeout=0.0, isolation_level=None)) as connection:
            try:
                connection.execute("BEGIN IMMEDIATE")
            except sqlite3.OperationalError:
                os.kill(worker, signal.SIGCONT)
                time.sleep(0.01)
            else:
                connection.execute("ROLLBACK")
                return


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


def wait_until(holds: Callable[[], object], limit_s: float = 120.0) -> None:
    """Wait for an event; only a hang reaches the limit."""
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


@contextmanager
def serving(folder: Path, environment: dict[str, str], *flags: str, prefix: Sequence[str] = ()) -> Iterator[Service]:
    """`sawmill serve` with a data folder of its own, once it is ready; `prefix` is a command that becomes it."""
    port, data, log = free_port(), folder / "data", folder / "service.log"
    serve = ["-m", "sawmill_command.commands", "serve", "--data", str(data), "--port", str(port), *flags]
    command = [*prefix, sys.executable, *serve]
    address = f"http://127.0.0.1:{port}"
    with (
        process(command, environment, log) as server,
        httpx.Client(base_url=address, timeout=ANSWER_S, trust_env=False) as client,
    ):
        wait_until_ready(client, server, log)
        yield Service(client, data, server.pid)


def wait_until_ready(client: httpx.Client, server: "subprocess.Popen[bytes]", log: Path) -> None:
    def ready() -> bool:
        assert server.poll() is None, log.read_text()
        with suppress(httpx.TransportError):
            return client.get("/health/ready").is_success
        return False

    wait_until(ready, START_S)


HOLDER = """
import sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("BEGIN IMMEDIATE")
print("held", flush=True)
sys.stdin.read()
connection.execute("ROLLBACK")
"""


@contextmanager
def write_lock(database: Path) -> Iterator[None]:
    command = [sys.executable, "-c", HOLDER, str(database)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == b"held\n"
        yield
        holder.stdin.close()
        holder.wait()


# Each child writes what it printed when it ends, in one piece: a pipe takes 4096 bytes at once.
SCRIPT = """
import os, sys
{imports}
children = []
for _ in range({count}):
    child = os.fork()
    if not child:
        break
    children.append(child)
else:
    sys.exit(any([os.waitpid(child, 0)[1] for child in children]))
sys.stdout = open(1, "w", buffering=4096, closefd=False)
{program}
"""


def race(count: int, imports: str, program: str) -> str:
    script = SCRIPT.format(imports=imports, count=count, program=program)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
