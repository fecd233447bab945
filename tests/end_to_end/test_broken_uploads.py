"""Uploads over lines that break, against a real server: what it keeps is bit-exact, or nothing."""

import fcntl
import os
import signal
import socket
from random import Random

import pytest
from live_service import ANSWER_S, Service, wait_until
from tiers import first_by_day

from sawmill_platform.files.file_store import UNFINISHED

pytestmark = pytest.mark.slow


def connect(service: Service) -> socket.socket:
    return socket.create_connection((service.client.base_url.host, service.client.base_url.port), timeout=ANSWER_S)


def head(method: str, service: Service, path: str, offset: int, length: int) -> bytes:
    host = f"{service.client.base_url.host}:{service.client.base_url.port}"
    lines = (f"{method} {path} HTTP/1.1", f"Host: {host}", f"Upload-Offset: {offset}", f"Content-Length: {length}")
    return "\r\n".join((*lines, "\r\n")).encode()


def begin(service: Service, content: bytes) -> str:
    return f"/v1/uploads/{service.post('/v1/uploads', json={'size_bytes': len(content)})['id']}"


def offset_of(service: Service, path: str) -> int:
    """Ask where the next part begins; that ends the part that broke off."""
    return int(service.client.head(path).headers["Upload-Offset"])


def stored(service: Service, path: str, scanner_id: str) -> bytes:
    upload_id = path.rpartition("/")[2]
    scan = service.post("/v1/scans", params={"scanner_id": scanner_id, "data": "counts", "upload_id": upload_id})
    return (service.data / "uploads/scans" / scan["id"] / "original").read_bytes()


def send_in_broken_parts(service: Service, scanner_id: str, breaks: int) -> None:
    """Cut a part off at random bytes: the file is bit-exact."""
    random = Random(15)  # noqa: S311 - no secret
    content = random.randbytes(400_000)
    path, known = begin(service, content), 0
    for cut in sorted(random.sample(range(1, len(content)), breaks)):
        with connect(service) as line:
            line.sendall(head("PATCH", service, path, known, len(content) - known) + content[known:cut])
            if cut % 2:  # a reset, and not an end, for every other one
                line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
        now = offset_of(service, path)
        assert known <= now <= cut
        known = now
    while (
        answer := service.client.patch(path, content=content[known:], headers={"Upload-Offset": str(known)})
    ).status_code == 409:  # what the machine had taken of a cut line came to the service after HEAD
        assert answer.json()["code"] == "wrong-offset", answer.text
        known = int(answer.headers["Upload-Offset"])
        assert known <= cut
    assert answer.status_code == 200, answer.text
    assert stored(service, path, scanner_id) == content
    assert list((service.data / "incoming").iterdir()) == []


def problem_on(line: socket.socket) -> bytes:
    """Read an answer up to the end of its JSON: the service still waits for the rest of the body."""
    answer = b""
    while not answer.endswith(b"}"):
        piece = line.recv(2**16)
        assert piece, answer
        answer += piece
    return answer


def is_coming(service: Service, path: str) -> bool:
    """Whether the service has begun to write a part."""
    file = service.data / UNFINISHED / path.rpartition("/")[2]
    if not file.exists():
        return False
    with file.open() as opened:
        try:
            fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def go_on_beside_open_lines(service: Service, scanner_id: str) -> None:
    """Ask for the offset, and send the next part, while the line of the earlier part is open and silent."""
    content = bytes(range(256)) * 1000
    path = begin(service, content)
    with connect(service) as first, connect(service) as second:
        first.sendall(head("PATCH", service, path, 0, len(content)) + content[:70_000])
        wait_until(lambda: is_coming(service, path))
        known = offset_of(service, path)
        assert b'"code":"upload-busy"' in problem_on(first)
        second.sendall(head("PATCH", service, path, known, len(content) - known) + content[known : known + 50_000])
        wait_until(lambda: is_coming(service, path))
        late = service.client.patch(path, content=content[:1], headers={"Upload-Offset": str(len(content))})
        assert (late.status_code, late.json()["code"]) == (409, "wrong-offset"), late.text
        assert b'"code":"upload-busy"' in problem_on(second)
    known = int(late.headers["Upload-Offset"])
    answer = service.client.patch(path, content=content[known:], headers={"Upload-Offset": str(known)})
    assert answer.status_code == 200, answer.text
    assert stored(service, path, scanner_id) == content


@pytest.mark.parametrize("breaks", first_by_day(1, [20, 200]))
def test_parts_are_cut_off_and_a_killed_service_goes_on_where_its_disk_is_and_leaves_nothing_else(
    tmp_path, offline, serve, breaks
):
    content = Random(16).randbytes(300_000)  # noqa: S311
    with serve(tmp_path, offline.variables, "--no-examples", "--workers", "0") as service:
        scanner_id = service.create_scanner()
        send_in_broken_parts(service, scanner_id, breaks)
        go_on_beside_open_lines(service, scanner_id)
        path = begin(service, content)
        service.client.patch(path, content=content[:100_000], headers={"Upload-Offset": "0"})
        with connect(service) as line, connect(service) as raw:
            line.sendall(head("PATCH", service, path, 100_000, 200_000) + content[100_000:150_000])
            query = f"scanner_id={scanner_id}&data=counts"
            raw.sendall(head("POST", service, f"/v1/scans?{query}", 0, 200_000) + content[:100_000])
            wait_until(lambda: list((service.data / "incoming").iterdir()))
            os.kill(service.process_id, signal.SIGKILL)
    with serve(tmp_path, offline.variables, "--no-examples", "--workers", "0") as service:
        assert list((service.data / "incoming").iterdir()) == []
        known = offset_of(service, path)
        assert 100_000 <= known <= 150_000
        answer = service.client.patch(path, content=content[known:], headers={"Upload-Offset": str(known)})
        assert answer.status_code == 200, answer.text
        assert stored(service, path, scanner_id) == content
