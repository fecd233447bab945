"""Client of the service for the demo: over HTTP, like a scanner's software."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx

from sawmill_vocabulary import Progress, ProgressCallback

START_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 30.0
POLL_S = 0.05
CHUNK_BYTES = 2**20

Json = dict[str, Any]
NO_SETTINGS: Mapping[str, str] = MappingProxyType({})


class DemoError(Exception):
    """The demo cannot continue; the message gives the reason."""


@contextmanager
def running_service(
    folder: Path, settings: Mapping[str, str] = NO_SETTINGS, *, workers: int | None = None
) -> Iterator[httpx.Client]:
    """Run `sawmill serve` on a free loopback port with its data and log in a folder; yield a client once it is ready.

    `settings` are environment variables in addition to the defaults; without `workers` there are as many as usual.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "sawmill_command.commands", "serve", "--port", str(port)]
    command += ["--data", str(folder / "data"), "--no-examples"]
    if workers is not None:
        command += ["--workers", str(workers)]
    log = folder / "service.log"
    # Settings of a mill's own service, above all its database, must not apply to the demo's service.
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")}
    with log.open("wb") as sink:
        service = subprocess.Popen(  # noqa: S603 - the product itself
            command, stdout=sink, stderr=sink, env={**kept, **settings}
        )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client:
                _wait_until_ready(client, service, log)
                yield client
        finally:
            service.terminate()
            try:
                service.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:  # the workers notice the end of the service and end too
                service.kill()
                service.wait()


def _wait_until_ready(client: httpx.Client, service: "subprocess.Popen[bytes]", log: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            raise DemoError(f"the service ended while starting:\n{log.read_text()[-2000:]}")
        try:
            answer = client.get("/health/ready")
        except httpx.TransportError:  # the service does not listen yet
            time.sleep(POLL_S)
            continue
        if answer.is_success:
            return
        raise DemoError(f"the service cannot be used: {answer.json()['detail']}")
    raise DemoError(f"the service was not ready within {START_TIMEOUT_S:.0f} s")


def post(client: httpx.Client, path: str, **options: Any) -> Json:  # noqa: ANN401 - httpx's own options
    """Send a POST request and return the JSON of the answer."""
    return _answer(client.post(path, **options))


def get(client: httpx.Client, path: str) -> Json:
    """Send a GET request and return the JSON of the answer."""
    return _answer(client.get(path))


def upload(client: httpx.Client, path: Path, on_progress: ProgressCallback, **spec: str) -> Json:
    """Stream a scan's file, and wait until the service has read it."""
    size = path.stat().st_size

    def chunks() -> Iterator[bytes]:
        sent = 0
        with path.open("rb") as stream:
            while chunk := stream.read(CHUNK_BYTES):
                sent += len(chunk)
                on_progress(Progress(sent / size, "upload"))
                yield chunk

    scan = _answer(client.post("/v1/scans", params=spec, content=chunks()))
    wait(client, scan["job_id"], on_progress)
    return get(client, f"/v1/scans/{scan['id']}")


def wait(client: httpx.Client, job_id: str, on_progress: ProgressCallback) -> Json:
    """Follow a job to its end."""
    while True:
        job = get(client, f"/v1/jobs/{job_id}")
        on_progress(Progress(**job["progress"]) if job["progress"] else Progress(0.0, job["state"]))
        if job["state"] == "succeeded":
            return job
        if job["state"] in {"failed", "cancelled"}:
            raise DemoError(f"job {job['kind']} {job['state']}: {job['failure'] and job['failure']['detail']}")
        time.sleep(POLL_S)


def download(client: httpx.Client, path: str, target: Path) -> Path:
    """Save a file of the service."""
    with client.stream("GET", path) as response, target.open("wb") as sink:
        response.raise_for_status()
        for chunk in response.iter_bytes(CHUNK_BYTES):
            sink.write(chunk)
    return target


def _answer(response: httpx.Response) -> Json:
    if response.is_error:
        problem = response.json()
        raise DemoError(f"{response.request.method} {response.request.url.path}: {problem.get('detail', problem)}")
    answer: Json = response.json()
    return answer
