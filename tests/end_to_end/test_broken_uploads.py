"""Uploads over lines that break, requests that their head refuses or that are none, and many requests at once."""

import fcntl
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from random import Random
from typing import Any
from uuid import uuid4

import httpx
import pytest
from live_service import ANSWER_S, Offline, Service, serving, wait_until, write_lock
from missing_parts import first_by_day, skip_without
from results import SCANNER_SPEC

from sawmill_platform.files.file_store import UNFINISHED


def head(method: str, service: Service, path: str, offset: int, length: int) -> bytes:
    host = f"{service.client.base_url.host}:{service.client.base_url.port}"
    lines = (f"{method} {path} HTTP/1.1", f"Host: {host}", f"Upload-Offset: {offset}", f"Content-Length: {length}")
    return "\r\n".join((*lines, "\r\n")).encode()


def begin_upload(service: Service, content: bytes) -> str:
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
    path, known = begin_upload(service, content), 0
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
    path = begin_upload(service, content)
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
    tmp_path, offline, breaks
):
    content = Random(16).randbytes(300_000)  # noqa: S311
    with serving(tmp_path, offline.variables, "--no-examples", "--workers", "0") as service:
        scanner_id = service.create_scanner()
        send_in_broken_parts(service, scanner_id, breaks)
        go_on_beside_open_lines(service, scanner_id)
        path = begin_upload(service, content)
        service.client.patch(path, content=content[:100_000], headers={"Upload-Offset": "0"})
        with connect(service) as line, connect(service) as raw:
            line.sendall(head("PATCH", service, path, 100_000, 200_000) + content[100_000:150_000])
            query = f"scanner_id={scanner_id}&data=counts"
            raw.sendall(head("POST", service, f"/v1/scans?{query}", 0, 200_000) + content[:100_000])
            wait_until(lambda: list((service.data / "incoming").iterdir()))
            os.kill(service.process_id, signal.SIGKILL)
    with serving(tmp_path, offline.variables, "--no-examples", "--workers", "0") as service:
        assert list((service.data / "incoming").iterdir()) == []
        known = offset_of(service, path)
        assert 100_000 <= known <= 150_000
        answer = service.client.patch(path, content=content[known:], headers={"Upload-Offset": str(known)})
        assert answer.status_code == 200, answer.text
        assert stored(service, path, scanner_id) == content


pytestmark = pytest.mark.slow

LIMIT_BYTES = 10_000
LARGE_BYTES = 50_000_000
QUOTA_BYTES = 10**6
POST = b"POST /v1/scanners HTTP/1.1\r\nHost: 127.0.0.1\r\n"
GET = b"GET /health/live HTTP/1.1\r\n"
HOST = b"Host: 127.0.0.1\r\n"


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    limits = {"JSON_BYTES": LIMIT_BYTES, "UPLOAD_BYTES": 10**16, "WAITING_UPLOAD_BYTES": QUOTA_BYTES}
    environment = offline.variables | {f"SAWMILL_MAX_{name}": str(limit) for name, limit in limits.items()}
    environment["SAWMILL_CHANGE_RATE_LIMIT"] = "10000/minute"  # many clients have one address here
    folder, flags = tmp_path_factory.mktemp("refusing"), ("--no-examples", "--workers", "0")
    with serving(folder, environment, *flags) as service:
        yield service


@pytest.fixture(scope="module")
def scanner_id(live: Service) -> str:
    return live.create_scanner()


def connect(service: Service) -> socket.socket:
    return socket.create_connection((service.client.base_url.host, service.client.base_url.port), timeout=ANSWER_S)


def read_problem(connection: socket.socket) -> tuple[int, str]:
    answer = http.client.HTTPResponse(connection)
    answer.begin()
    assert answer.headers["Content-Type"] == "application/problem+json"
    problem = json.load(answer)
    assert problem["status"] == answer.status
    return answer.status, problem["code"]


@pytest.mark.parametrize(
    "sent",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        GET + b"\r\n",
        GET + HOST + HOST + b"\r\n",
        POST + b"Content-Length: many\r\n\r\n",
        POST + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\nab",
        POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n",
        GET + HOST + b"a: " + b"b" * 20_000,
    ],
    ids=["TLS", "no host", "two hosts", "no length", "two lengths", "no chunk", "a head without an end"],
)
def test_what_is_no_http_gets_a_plain_400(live, sent):
    with connect(live) as connection:
        connection.sendall(sent)
        received = b""
        while part := connection.recv(2**16):
            received += part
    head, _, body = received.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 400 ")
    assert b"connection: close" in head.lower()
    assert b"Invalid HTTP request received." in body
    assert live.client.get("/health/live").is_success


def test_another_version_of_http_is_a_problem(live):
    with connect(live) as connection:
        connection.sendall(b"PRI * HTTP/2.0\r\nConnection: close\r\n\r\nSM\r\n\r\n")
        assert read_problem(connection) == (505, "http-version-unsupported")


def by_httpx(url: httpx.URL, body: bytes) -> tuple[int, str]:
    answer = httpx.post(url, content=body, timeout=ANSWER_S, trust_env=False)
    return answer.status_code, answer.json()["code"]


def by_http_client(url: httpx.URL, body: bytes) -> tuple[int, str]:
    client = http.client.HTTPConnection(url.host, url.port, timeout=ANSWER_S)
    client.request("POST", url.raw_path.decode(), body=body)
    answer = client.getresponse()
    problem = json.load(answer)
    client.close()
    return answer.status, problem["code"]


def by_curl(url: httpx.URL, body: bytes, *options: str) -> tuple[int, str]:
    program = shutil.which("curl") or skip_without("this test needs curl: apt-get install curl")
    form = "Content-Type: application/octet-stream"
    command = [program, "-sS", "-q", "--noproxy", "*", "-H", form, *options, "--data-binary", "@-", str(url)]
    done = subprocess.run([*command, "-w", "\n%{size_upload}"], input=body, capture_output=True, check=True)
    problem, _, sent_bytes = done.stdout.decode().rpartition("\n")
    assert bool(int(sent_bytes)) != bool(options)
    return json.loads(problem)["status"], json.loads(problem)["code"]


@pytest.mark.parametrize("send", [by_httpx, by_http_client, by_curl])
@pytest.mark.parametrize(
    ("path", "status", "code"),
    [("/v1/scanners", 413, "body-too-large"), ("/v1/scans?scanner_id=nobody&data=counts", 404, "scanner-not-found")],
)
def test_a_refusal_reaches_a_client_that_has_sent_a_small_body(
    live: Service, send: Callable[..., Any], path: str, status: int, code: str
):
    url = live.client.base_url.join(path)
    assert [send(url, bytes(LIMIT_BYTES + 1)) for _ in range(5)] == [(status, code)] * 5


@pytest.mark.parametrize("send", [by_httpx, by_http_client])
def test_a_refusal_by_length_reaches_a_client_that_sends_all_before_it_reads(live, send):
    assert send(live.client.base_url.join("/v1/scanners"), bytes(LARGE_BYTES)) == (413, "body-too-large")


def test_curl_asks_for_the_go_ahead_and_sends_nothing_of_a_large_body_that_is_refused(live):
    url = live.client.base_url.join("/v1/scans?scanner_id=nobody&data=counts")
    assert by_curl(url, bytes(LARGE_BYTES), "-H", "Expect: 100-continue") == (404, "scanner-not-found")


@pytest.mark.parametrize("go_ahead", [b"Expect: 100-continue\r\n", b""])
@pytest.mark.parametrize(
    ("path", "media_type", "length", "status", "code"),
    [
        ("/v1/scanners", "application/json", LIMIT_BYTES + 1, 413, "body-too-large"),
        ("/v1/scans?scanner_id=nobody&data=counts", "application/octet-stream", 10**7, 404, "scanner-not-found"),
        ("/v1/scans?scanner_id={scanner}&data=counts", "application/octet-stream", 10**15, 507, "storage-full"),
        ("/v1/inspections", "text/html", 10**7, 415, "unsupported-media-type"),
    ],
)
def test_an_upload_that_its_head_refuses_is_answered_before_a_byte_of_it_is_sent(
    live, scanner_id, go_ahead, path, media_type, length, status, code
):
    target = path.format(scanner=scanner_id)
    with connect(live) as connection:
        connection.sendall(f"POST {target} HTTP/1.1\r\nContent-Type: {media_type}\r\n".encode() + HOST + go_ahead)
        connection.sendall(f"Content-Length: {length}\r\n\r\n".encode())
        assert read_problem(connection) == (status, code)


def test_an_upload_beyond_the_quota_is_refused_when_it_is_declared(live):
    answer = live.client.post("/v1/uploads", json={"size_bytes": QUOTA_BYTES + 1})
    assert (answer.status_code, answer.json()["code"]) == (409, "upload-quota")


def test_an_upload_that_its_head_allows_gets_the_go_ahead(live, scanner_id):
    target = f"/v1/scans?scanner_id={scanner_id}&data=counts".encode()
    with connect(live) as connection:
        connection.sendall(b"POST " + target + b" HTTP/1.1\r\n" + HOST)
        connection.sendall(b"Expect: 100-continue\r\nContent-Length: 4\r\n\r\n")
        assert connection.recv(2**10).startswith(b"HTTP/1.1 100 Continue\r\n")
        connection.sendall(b"file")
        assert connection.recv(2**16).startswith(b"HTTP/1.1 202 Accepted\r\n")


def test_a_refused_body_ends_the_connection_when_it_has_come(live):
    with connect(live) as connection:
        connection.sendall(POST + b"Content-Length: %d\r\n\r\n" % (LIMIT_BYTES + 1))
        assert read_problem(connection) == (413, "body-too-large")
        connection.sendall(bytes(LIMIT_BYTES + 1))
        assert connection.recv(1) == b""


@pytest.mark.parametrize("line", [b"POST /v1/scanners", b"POST /nowhere", b"GET /health/live"])
def test_an_unread_body_without_an_end_is_cut_off(live, line):
    with connect(live) as connection:
        connection.sendall(line + b" HTTP/1.1\r\n" + HOST + b"Content-Length: 1000000000000\r\n\r\n")
        assert connection.recv(2**16).startswith(b"HTTP/1.1 ")
        with pytest.raises(ConnectionError):
            connection.sendall(bytes(2**30))


CLIENTS = 45  # more than the API has threads (40)
READS = 5


def test_writers_are_refused_and_readers_are_answered_while_the_lock_is_held(live, scanner_id):
    read = threading.Event()

    def write() -> list[httpx.Response]:
        answers = []
        while not answers or not read.is_set():
            query = {"scanner_id": scanner_id, "data": "counts"}
            answers.append(live.client.post("/v1/scans", params=query, content=b"a scan"))
        return answers

    with ThreadPoolExecutor(CLIENTS) as pool, write_lock(live.data / "sawmill.db"):
        writers = [pool.submit(write) for _ in range(CLIENTS)]
        try:
            statuses = [live.client.get("/v1/scanners").status_code for _ in range(READS)]
        finally:
            read.set()
        written = [answer for writer in writers for answer in writer.result()]
    # The lock is released here: every answer came before. A refused client comes back.
    wait_until(lambda: live.client.post("/v1/scanners", json=SCANNER_SPEC).is_success)
    assert statuses == [200] * READS
    assert {response.status_code for response in written} == {503}
    assert {response.json()["code"] for response in written} == {"storage-unavailable"}
    assert {int(response.headers["retry-after"]) > 0 for response in written} == {True}


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "busy_loops"), [(200, 0), (60, 4)])
def test_of_many_posts_at_once_none_is_refused(tmp_path, offline, phantom_scan, number, busy_loops):
    with serving(tmp_path, offline.variables, "--no-examples", "--workers", "1") as service, ExitStack() as running:
        scan = service.upload_phantom(phantom_scan())
        for _ in range(busy_loops):
            loop = running.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            running.callback(loop.kill)
        together = threading.Barrier(number, timeout=60)

        def post(seed: int) -> int:
            together.wait()
            ask = {"scan_id": scan["id"], "seed": seed}
            return client.post("/v1/calibrations", json=ask, headers={"Idempotency-Key": str(uuid4())}).status_code

        limits = httpx.Limits(max_connections=number)
        client = httpx.Client(base_url=service.client.base_url, limits=limits, timeout=120.0)
        with client, ThreadPoolExecutor(number) as pool:
            statuses = Counter(pool.map(post, range(number)))
    assert statuses == {202: number}
