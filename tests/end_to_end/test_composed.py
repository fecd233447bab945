"""What docker-compose.yml starts does a mill's work, as processes of this machine, and loses nothing."""

import shutil
import ssl
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import psycopg
import pytest
from compose_file import COMPOSE, PATIENCE_S, PROGRAMS, ROOT, Composed, Place, read_compose, wait_until
from live_service import SCANNER, descendants
from missing_parts import skip_without

from sawmill_platform.confinement import landlock

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs/do/containers.md"
NAME = "calibration.mill.example"
# Another address of this machine than the proxy's.
CLIENT = "127.0.0.7"
MIB = 2**20


@pytest.fixture
def composed() -> Iterator[Composed]:
    for program in ("caddy", "openssl", "wget", "initdb", "valkey-server"):
        if shutil.which(program, path=PROGRAMS) is None:
            skip_without(f"there is no {program}, which what compose starts needs here: install it (Debian has Caddy)")
    # Not in pytest's folder, which only its owner may enter: as root, PostgreSQL runs as another user.
    folder = Path(tempfile.mkdtemp(prefix="sawmill-compose-"))
    folder.chmod(0o755)
    [block] = [part for part in PAGE.read_text().split("```sh\n")[1:] if part.startswith("mkdir")]
    subprocess.run(["bash", "-euc", block.partition("```")[0]], cwd=folder, capture_output=True, check=True)
    started = Composed(Place(folder), read_compose(COMPOSE.read_text()))
    # Its examples have been made: their jobs would keep the workers busy.
    examples = folder / "volumes/files/examples"
    examples.mkdir(parents=True)
    (examples / "complete").touch()
    try:
        yield started
    finally:
        started.down()
        shutil.rmtree(folder)


def secret(composed: Composed, name: str) -> str:
    return (composed.place.folder / "secrets" / name).read_text().strip()


@pytest.fixture
def mill(composed: Composed) -> Iterator[httpx.Client]:
    """A program at the mill, which knows the service's name, its certificate and the token."""
    composed.up()
    composed.wait_for("proxy", "service_healthy")
    trusted = ssl.create_default_context(cafile=composed.place.folder / "secrets/tls_certificate")
    address = f"https://{NAME}:{composed.place.ports['tls']}"  # by the name: the certificate has no other
    token = {"Authorization": f"Bearer {secret(composed, 'sawmill_token')}"}
    by_name = ToLoopback(verify=trusted, local_address=CLIENT)
    with httpx.Client(base_url=address, transport=by_name, headers=token, timeout=120.0) as client:
        yield client


class ToLoopback(httpx.HTTPTransport):
    """Finds the mill's name here, as the mill's own name server would there."""

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        request.extensions["sni_hostname"] = request.url.host
        request.url = request.url.copy_with(host="127.0.0.1")
        return super().handle_request(request)


def arriving(composed: Composed) -> Iterator[bytes]:
    """No scan. Its second half is sent when the API has written some of the first."""
    yield bytes(MIB)
    incoming = composed.place.folder / "volumes/files/incoming"
    wait_until(lambda: any(path.stat().st_size for path in incoming.glob("*")), "the upload's first half there")
    yield bytes(MIB)


def test_what_compose_starts_does_a_mill_s_work(composed, mill, phantom_scan):
    address = f"http://127.0.0.1:{composed.place.ports['api']}"
    assert httpx.get(f"{address}/v1/scans", trust_env=False).status_code == 401
    health = composed.check("worker")
    assert mill.post("/v1/inspections", content=arriving(composed)).status_code == 202
    described = {"name": "Line 2", "constants": vars(SCANNER)}
    scanner = mill.post("/v1/scanners", json=described, headers={"X-Forwarded-For": "10.1.2.3"})
    assert scanner.headers["Strict-Transport-Security"] == "max-age=31536000"
    spec = {"scanner_id": scanner.json()["id"], "data": "counts", "phantom_id": "l-shape", "phantom_rows": "0:1"}
    scan = mill.post("/v1/scans", params=spec, content=phantom_scan(views=20)).json()
    calibration = mill.post("/v1/calibrations", json={"scan_id": scan["id"], "activate": True}).json()
    wait_for_end(mill, calibration["job_id"])
    at = f"/v1/calibrations/{calibration['id']}"
    assert mill.get(f"{at}/report.png").content.startswith(b"\x89PNG")
    assert mill.get(f"{at}/result.h5").content.startswith(b"\x89HDF")
    assert health.wait(PATIENCE_S) == 0
    # The proxy is believed about who asked, and it does not believe the client.
    entries = mill.get("/v1/audit").json()["items"]
    assert [entry["address"] for entry in entries if entry["action"] == "scanner-created"] == [CLIENT]
    assert not environments(composed) & {secret(composed, "sawmill_token"), secret(composed, "database_password")}
    with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
        composed.database(password="guessed")  # noqa: S106
    # Redis dies with a job on its way, and the wake-up of the next one is lost; then a worker, with a schedule due.
    composed.kill("redis")
    schedule = mill.post("/v1/schedules", json={"scanner_id": scanner.json()["id"], "cron": "0 0 1 1 *"}).json()
    lost = mill.post("/v1/calibrations", json={"scan_id": scan["id"]}).json()
    assert not composed.is_healthy("redis")
    composed.kill("worker")
    with composed.database() as connection:
        connection.execute("UPDATE schedules SET next_due_at = now() - interval '1 minute'")
    composed.start("redis")
    with mill.stream("GET", f"/v1/jobs/{lost['job_id']}/events") as stream:
        lines = stream.iter_lines()
        assert next(lines).startswith("event: job")  # before its end, for which it waits for seconds
        assert "event: end" in list(lines)
    wait_for_end(mill, lost["job_id"])
    wait_until(lambda: "schedule-ran" in composed.log("short-worker").read_text(), "the schedule run")
    assert [run["outcome"] for run in mill.get(f"/v1/schedules/{schedule['id']}/runs").json()] == ["queued"]
    for name in ("worker", "short-worker"):
        assert landlock.version() == 0 or "attempts-not-confined" not in composed.log(name).read_text()
    assert set(composed.down().values()) == {0}


def environments(composed: Composed) -> set[str]:
    found = set()
    for process in composed.processes.values():
        for member in descendants(process.pid):
            with suppress(FileNotFoundError, ProcessLookupError):  # ended meanwhile
                found |= {text.partition("=")[2] for text in Path(f"/proc/{member}/environ").read_text().split("\0")}
    assert composed.place.environment("api", composed.services["api"])["SAWMILL_TOKEN_FILE"] in found
    return found


def wait_for_end(mill: httpx.Client, job_id: str) -> None:
    for _ in range(4):
        job = mill.get(f"/v1/jobs/{job_id}", params={"wait": 55}).json()
        if job["state"] not in {"queued", "running"}:
            break
    assert (job["state"], job["losses"]) == ("succeeded", 0), job
