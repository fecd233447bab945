"""docker-compose.yml is valid, and what it starts and asks works: the same commands, on free loopback ports."""

import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
import yaml
from pydantic_settings import BaseSettings
from redis import Redis
from redis.exceptions import ConnectionError as RedisConnectionError

from sawmill_service.cli import main
from sawmill_service.settings import ServiceSettings
from sawmill_worker.execution.settings import ExecutionSettings
from sawmill_worker.storage.settings import StorageSettings

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
COMPOSE = ROOT / "docker-compose.yml"
SETTINGS: tuple[type[BaseSettings], ...] = (StorageSettings, ServiceSettings, ExecutionSettings)
BIN = Path(sys.executable).parent
# What the images of servers bring along; everything else must come from our own installation.
SERVERS = {"redis": {"redis-server", "redis-cli"}, "postgres": {"postgres", "pg_isready"}}
PATIENCE_S = 90.0
# The token's file beside docker-compose.yml, and as the API's container sees it.
TOKEN_FILE, IN_CONTAINER = "secrets/sawmill_token", "/run/secrets/sawmill_token"

Service = dict[str, Any]


@pytest.fixture(scope="module")
def services() -> dict[str, Service]:
    document: dict[str, dict[str, Service]] = yaml.safe_load(COMPOSE.read_text())
    return document["services"]


@dataclass(frozen=True)
class Place:
    """Where the services run here instead of in their containers."""

    redis_url: str
    port: int
    data: Path
    token: Path

    def moved(self, text: str) -> str:
        """A command's word or a variable's value, with this place's addresses; `$$` is compose's `$`."""
        for there, here in (
            ("redis://redis:6379/0", self.redis_url),
            ("0.0.0.0", "127.0.0.1"),  # noqa: S104 - the container's; tests stay on loopback
            ("8000", str(self.port)),
            ("/run/secrets/sawmill_token", str(self.token)),
            ("${SAWMILL_DATABASE_URL:-}", ""),
            ("$$", "$"),
        ):
            text = text.replace(there, here)
        return text

    def environment(self, service: Service) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
        given = {name: self.moved(value) for name, value in service["environment"].items()}
        containers = {
            "PATH": f"{BIN}:{os.environ['PATH']}",
            "HOSTNAME": socket.gethostname(),
            "SAWMILL_DATA_FOLDER": str(self.data),
        }
        return kept | given | containers


def health_check(service: Service) -> list[str]:
    """The command that compose runs."""
    kind, *words = service["healthcheck"]["test"]
    return words if kind == "CMD" else ["sh", "-c", *words]


def words(service: Service) -> Iterator[list[str]]:
    """Its command, and its health check's as it stands after the shell."""
    yield service["command"]
    check = health_check(service)
    yield check[2].split() if check[0] == "sh" else check


def test_it_is_a_valid_compose_file():
    check = [BIN / "check-jsonschema", "--builtin-schema", "vendor.compose-spec", COMPOSE]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_it_has_no_secret_and_opens_nothing_beyond_loopback(services):
    lines = [line.strip() for line in COMPOSE.read_text().splitlines() if not line.strip().startswith("#")]
    suspects = [line for line in lines if re.search(r"password|secret|token|://[^/]*@", line, re.IGNORECASE)]
    # The one secret is named by the file that holds it, here and in its container.
    assert suspects == [
        f"SAWMILL_TOKEN_FILE: {IN_CONTAINER}",
        "secrets:",
        f"- {Path(IN_CONTAINER).name}",
        "secrets:",
        f"{Path(IN_CONTAINER).name}:",
        f"file: ./{TOKEN_FILE}",
    ]
    assert [port for service in services.values() for port in service.get("ports", [])] == ["127.0.0.1:8000:8000"]


def test_the_token_s_file_is_no_part_of_the_repository():
    assert f"{Path(TOKEN_FILE).parent}/" in (ROOT / ".gitignore").read_text().splitlines()


def test_every_service_is_watched_and_comes_back(services):
    for service in services.values():
        assert service["healthcheck"]["test"][0] in {"CMD", "CMD-SHELL"}
        assert service["restart"] == "unless-stopped"


def test_a_worker_has_time_to_give_its_job_back(services):
    settings = ExecutionSettings()
    allowed = int(services["worker"]["stop_grace_period"].removesuffix("s"))
    assert allowed > settings.stop_grace_s + settings.kill_grace_s + settings.housekeeping_s


def test_every_variable_is_a_setting(services):
    known = {f"SAWMILL_{name.upper()}" for settings in SETTINGS for name in settings.model_fields}
    ours = (service for name, service in services.items() if name not in SERVERS)
    given = {name for service in ours for name in service["environment"]}
    image = re.findall(r"\b(SAWMILL_\w+)=", (ROOT / "Dockerfile").read_text())
    assert given | set(image) <= known


def test_every_program_is_installed(services):
    for name, service in services.items():
        for program in (command[0] for command in words(service)):
            assert program in SERVERS[name] if name in SERVERS else (BIN / program).is_file(), program


def documented_commands() -> list[list[str]]:
    """What docs/operations.md says of one machine and of a cluster."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", (ROOT / "docs/operations.md").read_text(), re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [line.split() for line in lines if not line.startswith("export ")]


def test_every_sawmill_command_and_option_exists(services):
    application = typer.main.get_command(main)
    commands = [command for service in services.values() for command in words(service)] + documented_commands()
    ours = [command for command in commands if command[0] == "sawmill"]
    assert ours
    for _, subcommand, *rest in ours:
        # Parses, without running it; an unknown option or a bad value raises.
        application.commands[subcommand].make_context(subcommand, list(rest)).close()


def test_a_cluster_s_worker_is_documented_as_it_is_composed(services):
    composed = services["worker"]["command"]
    documented = next(command for command in documented_commands() if command[0] == "celery")
    assert documented == composed[: len(documented)]


def test_the_image_is_built_from_what_it_copies():
    kept = re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    copied = re.findall(r"^COPY ((?!--from)\S.*) \S+$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert sorted(kept) == sorted(" ".join(copied).split())
    assert all((ROOT / name).exists() for name in kept)


def make_token(folder: Path) -> Path:
    """As docs/operations.md says to make it."""
    page = (ROOT / "docs/operations.md").read_text()
    (block,) = re.findall(r"^```sh\n(mkdir .*?)^```$", page, re.MULTILINE | re.DOTALL)
    subprocess.run(["bash", "-euc", block], cwd=folder, check=True)
    return folder / TOKEN_FILE


@pytest.fixture
def start(services, redis_url, tmp_path) -> Iterator[tuple[Place, Callable[[str], Path]]]:
    """The place, and a function that starts a service there by compose's own command; it gives its log."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        place = Place(redis_url, free.getsockname()[1], tmp_path / "data", make_token(tmp_path))
    with ExitStack() as stack:

        def run(name: str) -> Path:
            log = stack.enter_context((tmp_path / f"{name}.log").open("w"))
            process = subprocess.Popen(
                [place.moved(word) for word in services[name]["command"]],
                env=place.environment(services[name]),
                cwd=tmp_path,
                stdout=log,
                stderr=log,
            )
            stack.callback(process.wait, 30)
            stack.callback(process.terminate)
            return Path(log.name)

        yield place, run


def is_healthy(place: Place, service: Service) -> bool:
    command = [place.moved(word) for word in health_check(service)]
    timeout_s = float(service["healthcheck"]["timeout"].removesuffix("s"))
    done = subprocess.run(command, env=place.environment(service), capture_output=True, timeout=timeout_s, check=False)
    return done.returncode == 0


def wait_until(holds: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"{what} was not so within {PATIENCE_S:.0f} s"
        time.sleep(0.2)


def test_the_services_start_and_their_health_checks_tell_the_truth(services, start):
    place, run = start
    # Its examples have been made: their jobs would keep the worker busy.
    (place.data / "examples").mkdir(parents=True)
    (place.data / "examples/complete").touch()
    for name, started in (("api", "serving"), ("worker", " ready.")):
        assert not is_healthy(place, services[name]), f"{name} does not run yet"
        log = run(name)
        # Celery's check takes seconds of a core: it is not asked before it can succeed.
        wait_until(lambda log=log, started=started: started in log.read_text(), f"{name} started")
        wait_until(lambda name=name: is_healthy(place, services[name]), f"{name} healthy")
    address = f"http://127.0.0.1:{place.port}"
    assert httpx.get(f"{address}/v1/scans/example", trust_env=False).status_code == 401
    token = {"Authorization": f"Bearer {place.token.read_text().strip()}"}
    with httpx.Client(base_url=address, headers=token, trust_env=False) as client:
        # A job reaches the worker through Redis.
        asked = client.post("/v1/inspections", content=b"no scan").json()
        job = f"/v1/jobs/{asked['job_id']}"
        wait_until(lambda: client.get(job).json()["state"] in {"succeeded", "failed"}, f"{client.get(job).text} ended")


def test_redis_health_check_reports_the_truth(services, redis_url):
    """The image of Redis brings redis-cli along; the command that it is given is sent to a real server here."""
    program, *command = health_check(services["redis"])
    assert program == "redis-cli"
    with Redis.from_url(redis_url) as server:
        assert server.execute_command(*command) is True
    with Redis(host="127.0.0.1", port=1) as nobody, pytest.raises(RedisConnectionError):
        nobody.execute_command(*command)
