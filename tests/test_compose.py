"""docker-compose.yml, judged without Docker; tests/end_to_end/test_composed.py starts its commands."""

import re
import subprocess
import sys
from ipaddress import ip_address, ip_network
from pathlib import Path

import pytest
import yaml
from compose_file import COMPOSE, OF_IMAGE, OURS, POSTGRES_BIN, ROOT, SECRETS, VALKEY_BIN, of_containers, read_compose
from page_blocks import KNOWN, blocks, check_options

from sawmill_platform.workers.settings import ExecutionSettings

PAGE, OPERATIONS = ROOT / "docs/do/containers.md", ROOT / "docs/do/run.md"
BIN = Path(sys.executable).parent
# What the images of others bring along; everything else must come from our own installation.
PROGRAMS = {"proxy": {"caddy", "wget"}, "redis": {"valkey-server", "valkey-cli"}}
PROGRAMS |= {"postgres": {"postgres", "pg_isready"}}
UNITS = {"m": 2**20, "g": 2**30}
# A template that is ready, and the worker itself.
BESIDE_A_JOB_BYTES = 600 * 2**20


@pytest.fixture(scope="module")
def document():
    return read_compose(COMPOSE.read_text())


@pytest.fixture(scope="module")
def services(document):
    return document["services"]


def ours(services):
    return {name: service for name, service in services.items() if name not in OF_IMAGE}


def words(service):
    kind, *check = service.get("healthcheck", {"test": ["NONE"]})["test"]
    return [service["command"], *([] if kind == "NONE" else [check[0].split() if kind == "CMD-SHELL" else check])]


def test_it_is_a_valid_compose_file():
    check = [BIN / "check-jsonschema", "--builtin-schema", "vendor.compose-spec", COMPOSE]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_everything_that_is_named_is_there_and_used(document, services):
    for kind in ("secrets", "networks"):
        assert {name for service in services.values() for name in service.get(kind, [])} == set(document[kind])
    mounted = [pair for service in services.values() for pair in of_containers(service, "volumes")]
    assert {source for source, _ in mounted if "/" not in source} == set(document["volumes"])
    assert all((ROOT / source).is_file() for source, _ in mounted if "/" in source)
    assert {needed for service in services.values() for needed in service.get("depends_on", {})} <= set(services)
    # Those of the file before: files that a new database does not know would be removed as leftovers.
    assert not {"data", "rows"} & set(document["volumes"])


def test_secrets_are_files_of_their_own_which_the_page_makes(document, services):
    assert document["secrets"] == {name: {"file": f"./secrets/{name}"} for name in document["secrets"]}
    assert set(re.findall(r"\bsecrets/(\w+)", PAGE.read_text())) == set(document["secrets"])
    assert "secrets/" in (ROOT / ".gitignore").read_text().splitlines()
    # Each service reads those that it names, at the place where compose puts them, and has no other.
    for name, service in services.items():
        texts = [*service.get("environment", {}).values(), *service["command"]]
        if name == "proxy":
            [(source, _)] = of_containers(service, "volumes")
            texts += (ROOT / source).read_text().split()
        read = {text.removeprefix(SECRETS) for text in texts if text.startswith(SECRETS)}
        assert read == set(service.get("secrets", [])), name


def test_no_secret_stands_in_it():
    lines = [line.strip() for line in COMPOSE.read_text().splitlines() if not line.strip().startswith("#")]
    suspects = [line for line in lines if re.search(r"PASSWORD|TOKEN|KEY|://[^/]*:[^/]*@", line)]
    assert suspects
    assert all(re.fullmatch(r"[A-Z_]+_FILE: /run/secrets/\w+", line) for line in suspects)


def test_every_container_is_held_watched_and_comes_back(services):
    for name, service in services.items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service.get("cap_add", []) == (["NET_BIND_SERVICE"] if name == "proxy" else []), name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert int(service["user"].split(":")[0]) > 0, name
        assert service["logging"]["options"], name
        assert set(service["deploy"]["resources"]["limits"]) == {"cpus", "memory", "pids"}, name
        assert not {"privileged", "devices", "network_mode", "pid", "ipc"} & set(service), name
        once = name == "migrate"
        assert service["restart"] == ("on-failure:3" if once else "unless-stopped")
        assert ("healthcheck" in service) is not once


def test_the_proxy_alone_is_reached_and_the_api_believes_it_alone(document, services):
    reached = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert reached == {"proxy": ["443:8443"]}
    inside = {name for name, network in document["networks"].items() if (network or {}).get("internal")}
    assert {name for name, service in services.items() if set(service["networks"]) - inside} == {"proxy"}
    [front] = document["networks"]["front"]["ipam"]["config"]
    fixed = {name: services[name]["networks"]["front"]["ipv4_address"] for name in ("proxy", "api")}
    assert all(ip_address(address) in ip_network(front["subnet"]) for address in fixed.values())
    assert services["api"]["environment"]["SAWMILL_TRUSTED_PROXIES"] == f'["{fixed["proxy"]}"]'
    assert "back" not in services["proxy"]["networks"]


def test_a_service_starts_when_what_it_needs_is_there(services):
    needs = {name: service.get("depends_on", {}) for name, service in services.items()}
    assert needs["migrate"] == {"postgres": {"condition": "service_healthy"}}
    for name in ("api", "worker", "short-worker"):
        assert needs[name]["migrate"] == {"condition": "service_completed_successfully"}
    assert needs["proxy"] == {"api": {"condition": "service_healthy"}}


def test_what_is_stopped_has_time_to_end_and_a_worker_s_limits_are_those_of_its_jobs(services):
    settings = ExecutionSettings()
    needed = settings.stop_grace_s + settings.kill_grace_s + settings.housekeeping_s
    for name in ("api", "worker", "short-worker"):
        assert int(services[name]["stop_grace_period"].removesuffix("s")) > needed
    for name in ("worker", "short-worker"):
        limits, given = services[name]["deploy"]["resources"]["limits"], services[name]["environment"]
        assert limits["cpus"] == given["SAWMILL_NUMBA_NUM_THREADS"]
        memory_bytes = int(limits["memory"][:-1]) * UNITS[limits["memory"][-1]]
        assert int(given["SAWMILL_MEMORY_LIMIT_BYTES"]) + BESIDE_A_JOB_BYTES < memory_bytes


def test_the_page_has_each_service_with_its_limits(services):
    rows = re.findall(r"^\| `([\w-]+)` \| .* \| (\d+) ([GM])iB, (\d) \|", PAGE.read_text(), re.MULTILINE)
    documented = {name: (f"{size}{unit.lower()}", cores) for name, size, unit, cores in rows}
    limits = {name: service["deploy"]["resources"]["limits"] for name, service in services.items()}
    cores = {name: re.sub(r"\$\{\w+:-(\d)\}", r"\1", limit["cpus"]) for name, limit in limits.items()}
    assert documented == {name: (limit["memory"], cores[name]) for name, limit in limits.items()}


def test_redis_holds_nothing_that_matters(services):
    command = " ".join(services["redis"]["command"])
    assert "--save  --appendonly no --maxmemory 64mb --maxmemory-policy noeviction" in command
    assert of_containers(services["redis"], "volumes") == []


def test_every_variable_is_a_setting_and_every_program_is_installed(services):
    given = {name for service in ours(services).values() for name in service["environment"]}
    assert given | set(re.findall(r"\b(SAWMILL_\w+)=", (ROOT / "Dockerfile").read_text())) <= KNOWN
    for name, service in services.items():
        for program in (command[0] for command in words(service)):
            assert program in PROGRAMS[name] if name in PROGRAMS else (BIN / program).is_file(), program


def test_the_servers_are_those_that_tests_run_with(services):
    for image, server in (("postgres", POSTGRES_BIN / "postgres"), ("valkey/valkey", VALKEY_BIN / "valkey-server")):
        printed = subprocess.run([server, "--version"], capture_output=True, text=True, check=True).stdout
        version = re.search(r"\d+\.\d+(\.\d+)?", printed)
        assert version is not None
        assert f"{image}:{version[0]}-alpine" in {service["image"] for service in services.values()}
    assert all(re.search(r":\d+\.\d+", service["image"]) for service in services.values())


def documented_commands():
    lines = [line for block in blocks(OPERATIONS, "sh") for line in block.splitlines()]
    return [line.split() for line in lines if not line.startswith("export ")]


def test_every_sawmill_command_and_option_exists(services):
    commands = [command for service in services.values() for command in words(service)]
    named = [command for command in [*commands, *documented_commands()] if command[0] == "sawmill"]
    assert named
    for command in named:
        check_options(command[1:])


def test_what_the_page_adds_fits(document, services):
    [added] = [yaml.safe_load(block) for block in blocks(PAGE, "yaml")]
    for name, service in added["services"].items():
        assert set(service) <= {"environment", "networks"}
        assert set(service["networks"]) <= set(document["networks"]) - set(services[name]["networks"])
        assert set(service["environment"]) <= KNOWN - set(services[name]["environment"])


def test_services_that_the_page_names_are_there_and_a_cluster_s_worker_is_documented_as_composed(services):
    page = PAGE.read_text().replace("\\\n ", "")
    lines = re.findall(r"docker compose (?:exec(?: -T)?|restart|logs) (.*?)(?:`|$)", page, re.MULTILINE)
    named = [re.split(r" +(?:sawmill|pg_dump|sh) ", line)[0] for line in lines]
    assert len(named) > 5
    assert {name for names in named for name in names.split()} <= set(services)
    composed = services["worker"]["command"]
    documented = next(command for command in documented_commands() if command[0] == "celery")
    assert documented == composed[: len(documented)]


def test_the_image_is_built_from_what_it_copies_and_what_is_pinned():
    dockerfile = (ROOT / "Dockerfile").read_text()
    kept = re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    copied = re.findall(r"^COPY ((?!--from)\S.*) \S+$", dockerfile, re.MULTILINE)
    assert sorted(kept) == sorted(" ".join(copied).split())
    assert all((ROOT / name).exists() for name in kept)
    assert "--no-deps --only-binary=:all: --require-hashes --requirement /src/hashes.txt" in dockerfile
    assert set(re.findall(r"^FROM (\S+)", dockerfile, re.MULTILINE)) == {"${BASE}"}


def test_the_image_s_user_and_folders_are_those_of_the_services(services):
    dockerfile = (ROOT / "Dockerfile").read_text()
    assert f"useradd --home-dir {OURS['HOME']} --uid 1000 sawmill" in dockerfile
    assert f"SAWMILL_DATA_FOLDER={OURS['SAWMILL_DATA_FOLDER']}" in dockerfile
    assert f"WORKDIR {OURS['SAWMILL_DATA_FOLDER']}" in dockerfile
    [kernels] = re.findall(r"NUMBA_CACHE_DIR=(\S+)", dockerfile)
    # Numba takes a cache that it cannot write to for none.
    for name in ("worker", "short-worker"):
        assert kernels in {target for _, target in of_containers(services[name], "volumes")}
    for service in ours(services).values():
        assert service["user"] == "1000:1000"
        written = {target for kind in ("volumes", "tmpfs") for _, target in of_containers(service, kind)}
        assert set(OURS.values()) <= written
