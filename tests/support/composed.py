"""What docker-compose.yml starts, as processes held as its containers are; `compose_file.Place` is the rest."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import contained
import psycopg
from compose_file import POSTGRES_BIN, ROOT, Place, Service, interpolated, of_containers
from postgres_server import OPTIONS
from redis import Redis
from redis.backoff import NoBackoff
from redis.exceptions import RedisError
from redis.retry import Retry

PATIENCE_S = 120.0
# Between two looks: a health check is a process of its own.
LOOK_S = 0.3


@dataclass
class Composed:
    """What is up, by name."""

    place: Place
    document: dict[str, Any]
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def up(self) -> None:
        """Start everything, each service when those that it depends on are as it says."""
        (self.place.folder / "read-only").mkdir(mode=0o500)
        for name in self.in_order():
            for needed, how in self.services[name].get("depends_on", {}).items():
                self.wait_for(needed, how["condition"])
            self.start(name)

    @property
    def services(self) -> dict[str, Service]:
        return self.document["services"]

    def in_order(self) -> list[str]:
        """Each after those that it depends on; those that need not wait for the others first."""
        order: list[str] = []
        while len(order) < len(self.services):
            later = {name: each.get("depends_on", {}) for name, each in self.services.items() if name not in order}
            ready = [name for name, needed in later.items() if set(needed) <= set(order)]
            assert ready, f"these wait for each other: {set(self.services) - set(order)}"
            order += ready
        return order

    def start(self, name: str) -> None:
        service = self.services[name]
        mounted = self.place.mounted(name, service)
        for folder in mounted.values():
            folder.mkdir(parents=True, exist_ok=True)
        environment, user = self.place.environment(name, service), None
        if name == "proxy":
            _configure_proxy(self.place, service)
        if name == "postgres":
            user = _make_database(self.place, environment, Path(environment["PGDATA"]))
        held = [sys.executable, "-I", "-S", contained.__file__, user or "", *map(str, mounted.values()), "--"]
        command, at = [*held, *self.place.command(name, service["command"])], mounted.get("/data", self.place.folder)
        with self.log(name).open("ab") as log:
            to_log = {"stdout": log, "stderr": log}
            self.processes[name] = subprocess.Popen(command, env=environment, cwd=at, **to_log, start_new_session=True)
        if name == "postgres":
            self.wait_for(name, "service_healthy")
            with self.database("postgres") as connection:  # as the image does
                connection.execute("CREATE DATABASE sawmill")

    def log(self, name: str) -> Path:
        return self.place.folder / f"{name}.log"

    def check(self, name: str) -> subprocess.Popen[bytes]:
        """Its health check, begun."""
        kind, *words = self.services[name]["healthcheck"]["test"]
        command = self.place.command(name, words) if kind == "CMD" else ["sh", "-c", interpolated(words[0], {})]
        environment, nowhere = self.place.environment(name, self.services[name]), subprocess.DEVNULL
        return subprocess.Popen(command, env=environment, stdout=nowhere, stderr=nowhere)

    def is_healthy(self, name: str) -> bool:
        if name == "redis":  # the wheel has no client: what it would send is sent
            _, command = self.services[name]["healthcheck"]["test"][1:]
            with Redis(port=int(self.place.ports["redis"]), retry=Retry(NoBackoff(), 0)) as server:
                try:
                    return server.execute_command(command) is True
                except RedisError:
                    return False
        return self.check(name).wait(PATIENCE_S) == 0

    def wait_for(self, name: str, condition: str) -> None:
        process = self.processes[name]
        if condition == "service_completed_successfully":
            assert process.wait(PATIENCE_S) == 0, self.log(name).read_text()
            return
        assert condition == "service_healthy"

        def holds() -> bool:
            assert process.poll() is None, self.log(name).read_text()
            return self.is_healthy(name)

        wait_until(holds, f"{name} healthy")

    def database(self, name: str = "sawmill", password: str | None = None) -> psycopg.Connection[Any]:
        """A connection as the owner, with the password of the file or another one."""
        given = self.place.environment("postgres", self.services["postgres"])
        if password is None:
            password = Path(given["POSTGRES_PASSWORD_FILE"]).read_text().rstrip("\n")
        port = int(self.place.ports["postgres"])
        user = given["POSTGRES_USER"]
        return psycopg.connect(host="127.0.0.1", port=port, user=user, dbname=name, password=password, autocommit=True)

    def kill(self, name: str) -> None:
        """Its whole container, without a warning."""
        process = self.processes[name]
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def down(self) -> dict[str, int]:
        """Stop everything, those first that others do not need; give exit codes by name."""
        ended = {}
        for name in reversed(self.in_order()):
            process = self.processes.pop(name, None)
            if process is None or process.poll() is not None:
                continue
            # The image of PostgreSQL says so: SIGTERM would wait for its clients.
            process.send_signal(signal.SIGINT if name == "postgres" else signal.SIGTERM)
            ended[name] = process.wait(PATIENCE_S)
        return ended


def wait_until(holds: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"{what} was not so within {PATIENCE_S:.0f} s"
        time.sleep(LOOK_S)


def _configure_proxy(place: Place, service: Service) -> None:
    [(source, _)] = of_containers(service, "volumes")
    text = place.moved((ROOT / source).read_text())
    # Tests stay on loopback.
    (place.folder / "Caddyfile").write_text(text.replace("{\n", "{\n\tdefault_bind 127.0.0.1\n", 1))


def _make_database(place: Place, environment: dict[str, str], data: Path) -> str | None:
    """What the image does at its first start: a cluster whose owner and password are given."""
    user = None
    if os.geteuid() == 0:
        user = "nobody"  # it starts as anybody but root
        shutil.chown(data, user)
    password = place.folder / "database_password"
    shutil.copy(environment["POSTGRES_PASSWORD_FILE"], password)
    password.chmod(0o644)
    options = [f"--username={environment['POSTGRES_USER']}", f"--pwfile={password}", "--no-sync"]
    initdb = [POSTGRES_BIN / "initdb", *options, *environment["POSTGRES_INITDB_ARGS"].split()]
    subprocess.run(initdb, env=environment, user=user, stdout=subprocess.DEVNULL, check=True)
    password.unlink()
    with (data / "pg_hba.conf").open("a") as access:
        access.write("host all all all scram-sha-256\n")
    with (data / "postgresql.conf").open("a") as settings:
        settings.writelines(f"{name} = '{value}'\n" for name, value in OPTIONS.items())
    return user
