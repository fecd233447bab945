"""How a service ends: in order, in time, and without a word too many, whatever is open."""

import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

import pytest
from live_service import ANSWER_S, running, serving, wait_until

pytestmark = pytest.mark.slow


@contextmanager
def sending(address: str, request: str) -> Iterator[socket.socket]:
    """A connection on which a request was begun; nothing is read or sent unless the caller does."""
    host, port = address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=ANSWER_S) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(f"{request}\r\nHost: {host}:{port}\r\n".encode())
        yield connection


def read_all(connection: socket.socket) -> str:
    received = b""
    while part := connection.recv(65_536):
        received += part
    return received.decode()


@pytest.fixture
def starting(offline, tmp_path: Path) -> Callable[..., AbstractContextManager]:
    return lambda *flags: serving(tmp_path, offline.variables, "--no-examples", *flags)


def quiet(log: Path) -> str:
    text = log.read_text()
    assert not [word for word in ("Traceback", "Cancel ", "Exception", "ASGI callable") if word in text], text
    return text


def test_everything_open_hears_that_the_service_stops(starting, tmp_path):
    with starting("--workers", "0") as service:
        scanner_id = service.create_scanner()
        spec = f"scanner_id={scanner_id}&data=counts"
        scan = service.upload(b"a scan", scanner_id=scanner_id, data="counts")
        address = str(service.client.base_url)
        unread_host = address.removeprefix("http://")
        with (
            sending(address, f"GET /v1/jobs/{scan['job_id']}/events HTTP/1.1") as stream,
            sending(address, f"POST /v1/scans?{spec} HTTP/1.1\r\nContent-Length: 100") as stuck,
            sending(address, f"POST /v1/scans?{spec} HTTP/1.1\r\nContent-Length: 8") as slow,
            sending(address, "GET /openapi.json HTTP/1.1") as unread,
        ):
            # Answers of some 40 MB together, far more than the sockets between hold.
            unread.sendall(b"\r\n" + f"GET /openapi.json HTTP/1.1\r\nHost: {unread_host}\r\n\r\n".encode() * 200)
            stream.sendall(b"\r\n")
            for connection in (stuck, slow):
                connection.sendall(b"\r\nhalf")
            wait_until(lambda: len(list((tmp_path / "data" / "incoming").iterdir())) == 2)
            os.kill(service.process_id, signal.SIGTERM)
            heard = [line for line in read_all(stream).splitlines() if ": " in line]
            slow.sendall(b"half")  # two seconds are left for bodies when the stream has ended
            assert "202 Accepted" in read_all(slow), "there was time for it"
            (number,) = {line for line in heard if line.startswith("id: ")}
            assert heard[-4:] == ["event: closing", 'data: "queued"', number, "retry: 1000"]
            refused = read_all(stuck)
            assert "503 Service Unavailable" in refused
            assert '"code":"stopping"' in refused
            wait_until(lambda: not running(service.process_id))  # `unread` reads nothing, and does not hold it
    quiet(tmp_path / "service.log")
    assert list((tmp_path / "data" / "incoming").iterdir()) == []


def test_a_second_ctrl_c_cuts_off_what_the_first_one_waits_for(starting, tmp_path):
    with starting("--workers", "1") as service:
        scanner_id = service.create_scanner()
        post = f"POST /v1/scans?scanner_id={scanner_id}&data=counts HTTP/1.1\r\nContent-Length: 100"
        with sending(str(service.client.base_url), post) as stuck:
            stuck.sendall(b"\r\nhalf")
            wait_until(lambda: list((tmp_path / "data" / "incoming").iterdir()))
            for _ in range(8):  # two of them may become one; the body has two seconds
                os.kill(service.process_id, signal.SIGINT)
                time.sleep(0.1)
            with suppress(ConnectionResetError):
                assert read_all(stuck) == "", "it was cut off before its time was over, and so without a refusal"
            wait_until(lambda: not running(service.process_id))
    quiet(tmp_path / "service.log")
    assert list((tmp_path / "data" / "incoming").iterdir()) == []
