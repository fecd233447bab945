"""Where the service may listen, by real processes and sockets. Requests go to loopback addresses alone."""

import json
import logging
import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import httpx
import pytest
from asgi import absent
from live_service import START_S, process, wait_until

from sawmill_service.http.listening import ListenError, RefusedAccepts, is_loopback, listen
from sawmill_service.settings import ServiceSettings

pytestmark = pytest.mark.slow

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
EVERYWHERE = "0.0.0.0"  # noqa: S104 - what is tested
OUT_OF_FILES = "socket.accept() out of system resource"


def command(folder: Path, *flags: str) -> list[str]:
    sawmill = str(Path(sys.executable).with_name("sawmill"))
    return [sawmill, "serve", "--data", str(folder / "data"), "--port", "0", "--workers", "0", "--no-examples", *flags]


def environment(**variables: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("SAWMILL_")} | variables


def logged(folder: Path, event: str) -> list[dict]:
    lines = map(json.loads, (folder / "service.log").read_text().splitlines())
    return [line for line in lines if line["event"] == event]


@contextmanager
def serving(folder: Path, *flags: str, prefix: Sequence[str] = (), **variables: str) -> Iterator[tuple]:
    """`sawmill serve` on a free port, which it logs once it answers: a client of it, and its process."""
    environ, log = environment(SAWMILL_LOG_FORMAT="json", **variables), folder / "service.log"

    def addresses() -> list[dict]:
        assert server.poll() is None, log.read_text()
        return logged(folder, "serving")

    with process([*prefix, *command(folder, *flags)], environ, log) as server:
        wait_until(addresses)
        address = f"http://127.0.0.1:{addresses()[0]['url'].rpartition(':')[2]}"
        with httpx.Client(base_url=address, trust_env=False, headers={"Connection": "close"}) as client:
            yield client, server


def answer_of(client: httpx.Client) -> tuple[int, str]:
    answer = client.get("/health/live", timeout=START_S)
    return answer.status_code, answer.text


def test_beyond_loopback_it_does_not_start_without_a_token_and_leaves_nothing_behind(tmp_path):
    asked = command(tmp_path, "--host", EVERYWHERE)
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


def test_a_folder_is_served_once_and_as_soon_as_its_service_was_killed_to_as_many_as_have_room(tmp_path):
    """Requests beyond the connections get a plain 503 until some have ended."""
    with serving(tmp_path) as (_, first):
        asked, environ = command(tmp_path), environment()
        second = subprocess.run(asked, env=environ, capture_output=True, text=True, timeout=START_S, check=False)
        first.kill()
    assert second.returncode == 1
    assert f"is served by process {first.pid} already: stop that one" in second.stderr
    assert "Traceback" not in second.stderr
    few = {"SAWMILL_MAX_CONNECTIONS": "5", "SAWMILL_MAX_STREAMS": "4"}
    proxy = {"SAWMILL_TOKEN": TOKEN, "SAWMILL_TRUSTED_PROXIES": '["127.0.0.1"]'}
    with serving(tmp_path, "--host", EVERYWHERE, **few, **proxy) as (client, _):
        modes = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "data", tmp_path / "data/sawmill.db")}
        assert modes == {"data": 0o700, "sawmill.db": 0o600}, "nobody else reads the secrets of webhooks"
        with ExitStack() as idle:
            for _ in range(4):
                idle.enter_context(socket.create_connection(("127.0.0.1", client.base_url.port)))
            wait_until(lambda: answer_of(client) == (503, "Service Unavailable"))
        wait_until(lambda: answer_of(client) == (200, "alive"))
    assert logged(tmp_path, "no-proxy") == []


def test_more_connections_than_files_may_be_open_leave_a_service_that_recovers_and_a_short_log(tmp_path):
    log = tmp_path / "service.log"
    with serving(tmp_path, prefix=["bash", "-c", 'ulimit -n 400; exec "$@"', "-"]) as (client, _):
        with ExitStack() as idle:
            for _ in range(1000):
                if OUT_OF_FILES in log.read_text():
                    break
                with suppress(TimeoutError):  # as many wait as the system keeps until they are accepted
                    idle.enter_context(socket.create_connection(("127.0.0.1", client.base_url.port), timeout=1.0))
        wait_until(lambda: answer_of(client) == (200, "alive"))
    assert 0 < log.read_text().count(OUT_OF_FILES) < 10
    (warning,) = logged(tmp_path, "fewer-connections")
    assert warning["connections"] == 72
    assert "1024 connections need 2304 open files" in warning["reason"]


def test_beyond_loopback_requests_need_the_token_and_the_log_names_once_what_a_proxy_would_add(tmp_path):
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    with serving(tmp_path, "--host", EVERYWHERE, SAWMILL_TOKEN_FILE=str(tmp_path / "token")) as (client, _):
        assert (client.get("/health/ready").status_code, client.get("/v1/scanners").status_code) == (200, 401)
        assert client.get("/v1/scanners", headers={"Authorization": "Bearer guessed"}).status_code == 401
        assert client.get("/v1/scanners", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200
        assert client.get("/", auth=("anybody", TOKEN)).status_code == 200
        assert client.get("/health/live", headers={"Host": "mill.example"}).status_code == 421
    assert TOKEN not in (tmp_path / "service.log").read_text()
    (line,) = logged(tmp_path, "no-proxy")
    assert absent(line["reason"], "TLS", "slow clients") == []
