"""Clients that hold connections open, from outside: half heads, slow bodies, unread answers, and others.

The times allowed are shortened. Half the normal requests must be answered within a second, and all of them: on a
machine that runs other tests beside, a single one may wait for the processor.
"""

import socket
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

HEADS, BODIES, READERS, WAITERS = 1500, 40, 30, 200
AT_ONCE, STREAMS = 32, 3
SHORT_S = 1.5
SETTINGS = {
    "SAWMILL_HEAD_TIMEOUT_S": str(SHORT_S),
    "SAWMILL_CLIENT_SILENCE_S": str(SHORT_S),
    "SAWMILL_BODY_GRACE_S": "0.5",
    "SAWMILL_MIN_CLIENT_BYTES_PER_S": "10000",
    "SAWMILL_MAX_BODIES_AT_ONCE": str(AT_ONCE),
    "SAWMILL_MAX_STREAMS": str(STREAMS),
}


@pytest.fixture(scope="module")
def service(serve: Callable[..., Any], offline: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("floods")
    with serve(folder, {**offline.variables, **SETTINGS}, "--no-examples", "--workers", "0") as running:
        running.scanner_id = running.create_scanner()
        yield running


@contextmanager
def opened(service: Any, count: int, request: str, *, ending: str = "\r\n") -> Iterator[list[socket.socket]]:
    """Connections that have sent a request's first lines."""
    address = service.client.base_url
    with ExitStack() as stack:
        connections = []
        for _ in range(count):
            connection = socket.socket()
            stack.callback(connection.close)
            # Set before the connection is made: the window that the service may fill is this small.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.settimeout(30.0)
            connection.connect((address.host, address.port))
            connection.sendall(f"{request} HTTP/1.1\r\nHost: {address.host}{ending}".encode())
            connections.append(connection)
        yield connections


def last_words(connection: socket.socket) -> str:
    """What comes until the service has closed the connection."""
    received = b""
    try:
        while part := connection.recv(65_536):
            received += part
    except ConnectionResetError:
        pass
    return received.decode()


def time_of_others(service: Any) -> float:
    """Of requests on connections of their own, from the same address: the median."""
    address, key = service.client.base_url, service.client.headers
    times = []
    # None is kept: one that waits for its next request may give way to the flood just when it is used again.
    with httpx.Client(base_url=address, headers=key, limits=httpx.Limits(max_keepalive_connections=0)) as others:
        for _ in range(9):
            began = time.monotonic()
            assert others.get("/v1/scanners", timeout=30.0).is_success
            times.append(time.monotonic() - began)
    return statistics.median(times)


def sockets(service: Any) -> int:
    number = 0
    for entry in Path(f"/proc/{service.process_id}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            number += str(entry.readlink()).startswith("socket:")
    return number


def wait_for(condition: Callable[[], object], timeout_s: float = 20.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def test_half_heads_keep_nobody_out_and_do_not_stay(service):
    before = sockets(service)
    with opened(service, HEADS, "GET /") as connections:
        assert time_of_others(service) < 1.0
        words = [last_words(connection) for connection in connections]
    # The first ones gave way to the others; those that stayed are refused.
    assert "408" in words[-1]
    assert '"code":"slow-head"' in words[-1]
    assert words[0] == ""
    wait_for(lambda: sockets(service) <= before)


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\n"], ids=["nothing", "a byte now and then"])
def test_a_head_that_is_never_whole_is_given_up(service, sent):
    address = service.client.base_url
    with socket.create_connection((address.host, address.port), timeout=20.0) as connection:
        began = time.monotonic()
        connection.sendall(sent)
        while sent and time.monotonic() - began < SHORT_S:
            connection.sendall(b"a")
            time.sleep(0.2)
        assert ("408" in last_words(connection)) == bool(sent)
        assert time.monotonic() - began > 0.8 * SHORT_S


def test_slow_bodies_keep_nobody_out_and_leave_nothing(service):
    upload = f"POST /v1/scans?scanner_id={service.scanner_id}&data=counts"
    incoming = service.data / "incoming"
    with opened(service, BODIES, upload, ending="\r\nContent-Length: 100000\r\n\r\nhalf") as connections:
        wait_for(lambda: list(incoming.iterdir()))
        assert time_of_others(service) < 1.0
        words = [last_words(connection) for connection in connections]
    assert sum('"code":"slow-body"' in heard for heard in words) == AT_ONCE, words[0]
    assert sum('"code":"too-many-requests"' in heard for heard in words) == BODIES - AT_ONCE
    assert list(incoming.iterdir()) == []


def test_unread_answers_keep_nobody_out_and_are_cut_off(service):
    before = sockets(service)
    # Each some 56 MB, far more than the sockets between hold.
    host = service.client.base_url.host
    more = f"GET /openapi.json HTTP/1.1\r\nHost: {host}\r\n\r\n" * 200
    with opened(service, READERS, "GET /openapi.json", ending=f"\r\n\r\n{more}"):
        wait_for(lambda: sockets(service) >= before + READERS)
        assert time_of_others(service) < 1.0
        wait_for(lambda: sockets(service) <= before)


def test_streams_are_bounded_in_all_and_leave_their_places(service):
    job_id = service.upload(b"a scan that nobody reads", scanner_id=service.scanner_id, data="counts")["job_id"]
    stream = f"GET /v1/jobs/{job_id}/events"
    with opened(service, STREAMS, stream, ending="\r\n\r\n") as connections:
        assert all(b"200 OK" in connection.recv(1000) for connection in connections)
        refused = service.client.get(f"/v1/jobs/{job_id}/events")
        assert (refused.status_code, refused.json()["code"]) == (429, "too-many-requests")
        assert service.get(f"/v1/jobs/{job_id}").json()["state"] == "queued"

    def answered() -> bool:
        with service.client.stream("GET", f"/v1/jobs/{job_id}/events") as response:
            return response.status_code == 200

    wait_for(answered)


def test_a_slow_reader_gets_its_answer(service):
    with opened(service, 1, "GET /openapi.json", ending="\r\nConnection: close\r\n\r\n") as [connection]:
        received = 0
        while part := connection.recv(16_384):
            received += len(part)
            time.sleep(0.1)
    assert received > len(service.get("/openapi.json").content)


def test_two_hundred_that_wait_for_a_job_hold_nobody_up(service):
    spec = {"scanner_id": service.scanner_id, "data": "counts"}
    # A connection that is kept would be closed as idle while the next request is on its way.
    job_id = service.post("/v1/scans", params=spec, content=b"a scan", headers={"Connection": "close"})["job_id"]
    ending = "\r\nConnection: close\r\n\r\n"
    with opened(service, WAITERS, f"GET /v1/jobs/{job_id}?wait=50", ending=ending) as connections:
        assert time_of_others(service) < 1.0
        service.post(f"/v1/jobs/{job_id}/cancel")
        began = time.monotonic()
        answers = [last_words(connection) for connection in connections]
        assert time.monotonic() - began < 20.0, "they hear of the end, and not of the time that is over"
    assert {'"state":"cancelled"' in answer for answer in answers} == {True}
