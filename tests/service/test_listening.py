"""Where the service may listen, by real processes and sockets. Requests go to loopback addresses alone."""

import json
import logging
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import httpx
import pytest
from asgi import absent

from sawmill_service.http.listening import ListenError, RefusedAccepts, is_loopback, listen
from sawmill_service.settings import ServiceSettings

pytestmark = pytest.mark.slow

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
EVERYWHERE = "0.0.0.0"  # noqa: S104 - what is tested
START_S, STOP_S = 120.0, 120.0
OUT_OF_FILES = "socket.accept() out of system resource"


def command(folder: Path, *flags: str) -> list[str]:
    sawmill = Path(sys.executable).with_name("sawmill")
    return [str(sawmill), "serve", "--data", str(folder / "data"), "--workers", "0", "--no-examples", *flags]


def environment(**variables: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")} | variables


@contextmanager
def serving(folder: Path, *flags: str, **variables: str) -> Iterator[int]:
    """`sawmill serve` on a free port, once it answers."""
    log = folder / "service.log"
    with log.open("wb") as sink:
        process = subprocess.Popen(
            command(folder, "--port", "0", *flags),
            env=environment(SAWMILL_LOG_FORMAT="json", **variables),
            stdout=sink,
            stderr=sink,
        )
    try:
        yield port_of(process, log)
    finally:
        process.terminate()
        process.wait(STOP_S)


def port_of(process: "subprocess.Popen[bytes]", log: Path) -> int:
    """From its own log, after which it answers: its socket listens already."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        assert process.poll() is None, log.read_text()
        for line in log.read_text().splitlines():
            if json.loads(line)["event"] == "serving":
                return int(json.loads(line)["url"].rpartition(":")[2])
        time.sleep(0.05)
    raise AssertionError(log.read_text())


def test_beyond_loopback_it_does_not_start_without_a_token_and_leaves_nothing_behind(tmp_path):
    asked = command(tmp_path, "--host", EVERYWHERE, "--port", "0")
    done = subprocess.run(asked, env=environment(), capture_output=True, text=True, timeout=START_S, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("The service cannot start: 0.0.0.0 can be reached from other machines")
    assert "SAWMILL_TOKEN" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_every_address_beyond_loopback_needs_a_token_and_what_cannot_be_listened_on_is_a_sentence():
    for host in (EVERYWHERE, "::", "::ffff:0.0.0.0"):
        with pytest.raises(ListenError, match="SAWMILL_TOKEN"):
            listen(host, 0, guarded=False).close()
    for host in ("127.0.0.1", "127.9.8.7", "localhost", "::1"):
        with listen(host, 0, guarded=False) as listening:
            assert is_loopback(listening.getsockname()[0])
    assert is_loopback("::ffff:127.0.0.1")
    assert not any(is_loopback(address) for address in ("::ffff:192.0.2.1", "192.0.2.1", "::"))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ListenError, match=rf"^port {port} of 127\.0\.0\.1 is taken: .*--port[^\n]*$"):
            listen("127.0.0.1", port, guarded=False)
    with pytest.raises(ListenError, match=r"^192\.0\.2\.1 with port 8000 cannot be listened on: "):
        listen("192.0.2.1", 8000, guarded=True)
    with pytest.raises(ValueError, match="max_connections must be above max_streams"):
        ServiceSettings(max_connections=64, max_streams=64)


def test_connections_are_sent_at_once_end_without_their_client_and_refused_ones_are_logged_once_a_minute():
    with (
        listen("127.0.0.1", 0, guarded=False) as listening,
        socket.create_connection(listening.getsockname()),
        listening.accept()[0] as connection,
    ):
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 60_000
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 60
    log = RefusedAccepts()
    passed = []
    for time_s in (1000.0, 1001.0, 1059.0, 1061.0):
        for text in (OUT_OF_FILES, "Exception in callback BaseSelectorEventLoop._start_serving()", "another"):
            line = logging.makeLogRecord({"msg": text, "created": time_s})
            passed += [(time_s, text)] * log.filter(line)
    assert [line for line in passed if line[1] != "another"] == [(1000.0, OUT_OF_FILES), (1061.0, OUT_OF_FILES)]
    assert len(passed) == 6


def missing_a_proxy(log: Path) -> list[str]:
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return [line["reason"] for line in lines if line["event"] == "no-proxy"]


def test_a_folder_is_served_once_and_as_soon_as_its_service_was_killed_to_as_many_as_have_room(tmp_path):
    """Requests beyond the connections get a plain 503 until some have ended."""
    asked, variables = command(tmp_path, "--port", "0"), environment(SAWMILL_LOG_FORMAT="json")
    with (tmp_path / "killed.log").open("wb") as log:
        first = subprocess.Popen(asked, env=variables, stdout=log, stderr=log)
        try:
            port_of(first, tmp_path / "killed.log")
            second = subprocess.run(asked, env=variables, capture_output=True, text=True, timeout=START_S, check=False)
        finally:
            first.kill()
            first.wait(STOP_S)
    assert second.returncode == 1
    assert f"is served by process {first.pid} already: stop that one" in second.stderr
    assert "Traceback" not in second.stderr
    few = {"SAWMILL_MAX_CONNECTIONS": "5", "SAWMILL_MAX_STREAMS": "4"}
    proxy = {"SAWMILL_TOKEN": TOKEN, "SAWMILL_TRUSTED_PROXIES": '["127.0.0.1"]'}
    with (
        serving(tmp_path, "--host", EVERYWHERE, **few, **proxy) as port,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, headers={"Connection": "close"}) as client,
    ):
        modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "data", tmp_path / "data/sawmill.db")}
        assert modes == {"data": 0o700, "sawmill.db": 0o600}, "nobody else reads the secrets of webhooks"
        with ExitStack() as idle:
            for _ in range(4):
                idle.enter_context(socket.create_connection(("127.0.0.1", port)))
            assert answered_with(client, 503).text == "Service Unavailable"
        assert answered_with(client, 200).text == "alive"
    assert missing_a_proxy(tmp_path / "service.log") == []


def answered_with(client: httpx.Client, status: int) -> httpx.Response:
    """Ask until the service answers with a status: connections are opened and ended in its own time."""
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        answer = client.get("/health/live", timeout=START_S)
        if answer.status_code == status:
            return answer
        time.sleep(0.05)
    raise AssertionError(answer.status_code)


def test_more_connections_than_files_may_be_open_leave_a_service_that_recovers_and_a_short_log(tmp_path):
    limited = ["bash", "-c", 'ulimit -n 400; exec "$@"', "-", *command(tmp_path, "--port", "0")]
    log = tmp_path / "service.log"
    with log.open("wb") as sink:
        process = subprocess.Popen(limited, env=environment(SAWMILL_LOG_FORMAT="json"), stdout=sink, stderr=sink)
    try:
        port = port_of(process, log)
        with ExitStack() as idle:
            deadline = time.monotonic() + START_S
            while OUT_OF_FILES not in log.read_text():
                assert time.monotonic() < deadline
                with suppress(TimeoutError):  # as many wait as the system keeps until they are accepted
                    idle.enter_context(socket.create_connection(("127.0.0.1", port), timeout=1.0))
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False) as client:
            assert answered_with(client, 200).text == "alive"
    finally:
        process.terminate()
        process.wait(STOP_S)
    assert log.read_text().count(OUT_OF_FILES) < 10
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    (warning,) = [line for line in lines if line["event"] == "fewer-connections"]
    assert warning["connections"] == 72
    assert "1024 connections need 2304 open files" in warning["reason"]


def test_beyond_loopback_requests_need_the_token_and_the_log_names_once_what_a_proxy_would_add(tmp_path):
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    variables = {"SAWMILL_TOKEN_FILE": str(tmp_path / "token")}
    with (
        serving(tmp_path, "--host", EVERYWHERE, **variables) as port,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False) as client,
    ):
        assert (client.get("/health/ready").status_code, client.get("/v1/scanners").status_code) == (200, 401)
        assert client.get("/v1/scanners", headers={"Authorization": "Bearer guessed"}).status_code == 401
        assert client.get("/v1/scanners", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
        assert client.get("/", auth=("anybody", TOKEN)).status_code == 200
        assert client.get("/health/live", headers={"Host": "mill.example"}).status_code == 421
    assert TOKEN not in (tmp_path / "service.log").read_text()
    (reason,) = missing_a_proxy(tmp_path / "service.log")
    assert absent(reason, "TLS", "slow clients") == []
