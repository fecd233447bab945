"""Requests that are refused by their head, or before they are requests: raw sockets and clients as they are."""

import http.client
import json
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from live_service import Offline, Service, serving
from missing_parts import skip_without

pytestmark = pytest.mark.slow

LIMIT_BYTES = 10_000
LARGE_BYTES = 50_000_000
LARGEST_UPLOAD_BYTES, BEYOND_THE_DISK_BYTES = 10**16, 10**15
QUOTA_BYTES = 10**6
WAIT_S = 120.0
POST = b"POST /v1/scanners HTTP/1.1\r\nHost: 127.0.0.1\r\n"
GET = b"GET /health/live HTTP/1.1\r\n"
HOST = b"Host: 127.0.0.1\r\n"


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    limits = {
        "SAWMILL_MAX_JSON_BYTES": str(LIMIT_BYTES),
        "SAWMILL_MAX_UPLOAD_BYTES": str(LARGEST_UPLOAD_BYTES),
        "SAWMILL_MAX_WAITING_UPLOAD_BYTES": str(QUOTA_BYTES),
    }
    folder, flags = tmp_path_factory.mktemp("refusing"), ("--no-examples", "--workers", "0")
    with serving(folder, offline.variables | limits, *flags) as service:
        yield service


@pytest.fixture(scope="module")
def scanner_id(live: Service) -> str:
    return live.create_scanner()


def connect(service: Service) -> socket.socket:
    return socket.create_connection((service.client.base_url.host, service.client.base_url.port), timeout=WAIT_S)


def read_problem(connection: socket.socket) -> tuple[int, str]:
    """Read one answer, and return its status and its code."""
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
    answer = httpx.post(url, content=body, timeout=WAIT_S, trust_env=False)
    return answer.status_code, answer.json()["code"]


def by_http_client(url: httpx.URL, body: bytes) -> tuple[int, str]:
    client = http.client.HTTPConnection(url.host, url.port, timeout=WAIT_S)
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
        (
            "/v1/scans?scanner_id={scanner}&data=counts",
            "application/octet-stream",
            BEYOND_THE_DISK_BYTES,
            507,
            "storage-full",
        ),
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
            send_a_gibibyte(connection)


def send_a_gibibyte(connection: socket.socket) -> None:
    for _ in range(2**10):
        connection.sendall(bytes(2**20))
