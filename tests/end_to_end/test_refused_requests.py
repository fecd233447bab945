"""What is refused before it is a request, and while its body still comes: by raw sockets and clients as they are."""

import http.client
import json
import socket
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from live_service import Offline, Service, serving

LIMIT = 1_000_000
SENT = 50_000_000
POST = b"POST /v1/scanners HTTP/1.1\r\nHost: 127.0.0.1\r\n"
GET = b"GET /health/live HTTP/1.1\r\n"
HOST = b"Host: 127.0.0.1\r\n"


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory, offline: Offline) -> Iterator[Service]:
    environment = {**offline.variables, "SAWMILL_MAX_JSON_BYTES": str(LIMIT), "SAWMILL_LOG_FORMAT": "json"}
    with serving(tmp_path_factory.mktemp("refusing"), environment, "--no-examples", "--workers", "0") as service:
        yield service


@pytest.fixture(scope="module")
def scanner_id(live: Service) -> str:
    return live.create_scanner()


def connect(service: Service) -> socket.socket:
    return socket.create_connection((service.client.base_url.host, service.client.base_url.port), timeout=20)


def read_answer(connection: socket.socket) -> tuple[int, dict[str, str], Any]:
    """Until the service closes, which it does in order: a reset raises."""
    received = b""
    while part := connection.recv(2**16):
        received += part
    head, _, body = received.partition(b"\r\n\r\n")
    lines = head.decode().split("\r\n")
    headers = {name.lower(): value for name, value in (line.split(": ", 1) for line in lines[1:])}
    return int(lines[0].split()[1]), headers, json.loads(body)


@pytest.mark.parametrize(
    ("sent", "status", "code"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400, "bad-request-line"),
        (b"GET /health/live\r\n\r\n", 400, "bad-request-line"),
        (b"GET /a b HTTP/1.1\r\n" + HOST + b"\r\n", 400, "bad-request-line"),
        (b"G(T / HTTP/1.1\r\n" + HOST + b"\r\n", 400, "bad-request-line"),
        (GET + HOST + b"no colon\r\n\r\n", 400, "bad-header"),
        (GET + HOST + b"a: \x00\r\n\r\n", 400, "bad-header"),
        (GET + b"\r\n", 400, "bad-host"),
        (GET + HOST + HOST + b"\r\n", 400, "bad-host"),
        (POST + b"Content-Length: many\r\n\r\n", 400, "bad-length"),
        (POST + b"Content-Length: 1\r\nContent-Length: 2\r\n\r\nab", 400, "bad-length"),
        (POST + b"Transfer-Encoding: gzip\r\n\r\n", 501, "transfer-encoding-unsupported"),
        (POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n", 400, "bad-chunk"),
        (POST + b"Transfer-Encoding: chunked\r\n\r\n3\r\nabcde\r\n", 400, "bad-chunk"),
        (GET + HOST + b"a: " + b"b" * 100_000 + b"\r\n\r\n", 431, "head-too-large"),
        (b"GET /" + b"a" * 100_000 + b" HTTP/1.1\r\n" + HOST + b"\r\n", 431, "head-too-large"),
        (b"PRI * HTTP/2.0\r\nConnection: close\r\n\r\nSM\r\n\r\n", 505, "http-version-unsupported"),
    ],
)
def test_what_is_no_http_of_ours_is_a_problem(live, sent, status, code):
    with connect(live) as connection:
        connection.sendall(sent)
        answered, headers, problem = read_answer(connection)
    assert (answered, problem["status"], problem["code"]) == (status, status, code)
    assert headers["content-type"] == "application/problem+json"
    assert headers["x-request-id"] == problem["request_id"]
    assert headers["connection"] == "close"
    assert live.get(problem["type"]).json()["status"] == status
    log = (live.data.parent / "service.log").read_text().splitlines()
    lines = [line for line in map(json.loads, log) if line.get("request_id") == problem["request_id"]]
    assert [line["event"] for line in lines] == ["request"]


def test_a_refusal_reaches_a_client_that_sends_all_before_it_reads(live):
    client = http.client.HTTPConnection(live.client.base_url.host, live.client.base_url.port, timeout=30)
    client.request("POST", "/v1/scanners", body=bytes(SENT), headers={"Content-Type": "application/json"})
    answer = client.getresponse()
    assert (answer.status, json.load(answer)["code"]) == (413, "body-too-large")
    client.close()


def test_a_refusal_reaches_a_client_that_sends_chunks(live):
    parts = (bytes(1_000_000) for _ in range(SENT // 1_000_000))
    answer = httpx.post(f"{live.client.base_url}/v1/scanners", content=parts, timeout=30, trust_env=False)
    assert (answer.status_code, answer.json()["code"]) == (413, "body-too-large")


def test_a_body_whose_chunks_break_off_is_refused_while_it_is_sent(live):
    with connect(live) as connection:
        connection.sendall(POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n")
        for _ in range(50):
            connection.sendall(bytes(100_000))
        assert read_answer(connection)[2]["code"] == "bad-chunk"


def test_a_client_that_waits_for_the_go_ahead_sends_nothing(live):
    with connect(live) as connection:
        connection.sendall(POST + b"Expect: 100-continue\r\nContent-Length: %d\r\n\r\n" % SENT)
        status, headers, _ = read_answer(connection)
    assert (status, headers["connection"]) == (413, "close")


@pytest.mark.parametrize(
    ("path", "media_type", "length", "status", "code"),
    [
        ("/v1/scans?scanner_id=nobody&data=counts", "application/octet-stream", SENT, 404, "scanner-not-found"),
        ("/v1/scans?scanner_id={scanner}&data=counts", "text/html", SENT, 415, "unsupported-media-type"),
        ("/v1/scans?scanner_id={scanner}&data=counts", "application/octet-stream", 10**12, 413, "body-too-large"),
        ("/v1/scans?scanner_id={scanner}", "application/octet-stream", SENT, 422, "invalid-request"),
        ("/v1/scans/form", "multipart/form-data; boundary=x", 2**27, 413, "body-too-large"),
        ("/v1/scans/form", "application/octet-stream", SENT, 415, "unsupported-media-type"),
        ("/v1/phantoms/pictures?name=ell&width_mm=400", "text/html", 1000, 415, "unsupported-media-type"),
        ("/v1/inspections", "text/html", SENT, 415, "unsupported-media-type"),
    ],
)
def test_an_upload_that_its_head_refuses_gets_no_go_ahead(live, scanner_id, path, media_type, length, status, code):
    head = (
        f"POST {path.format(scanner=scanner_id)} HTTP/1.1",
        "Host: 127.0.0.1",
        "Expect: 100-continue",
        f"Content-Type: {media_type}",
        f"Content-Length: {length}",
    )
    with connect(live) as connection:
        connection.sendall("\r\n".join((*head, "\r\n")).encode())
        answered, _, problem = read_answer(connection)
    assert (answered, problem["code"]) == (status, code)


def test_an_upload_that_its_head_allows_gets_the_go_ahead(live, scanner_id):
    target = f"/v1/scans?scanner_id={scanner_id}&data=counts".encode()
    with connect(live) as connection:
        connection.sendall(b"POST " + target + b" HTTP/1.1\r\n" + HOST)
        connection.sendall(b"Expect: 100-continue\r\nContent-Length: 4\r\n\r\n")
        assert connection.recv(2**10).startswith(b"HTTP/1.1 100 Continue\r\n")
        connection.sendall(b"file")
        assert connection.recv(2**16).startswith(b"HTTP/1.1 202 Accepted\r\n")


def test_a_client_that_never_ends_is_cut_off(live):
    with connect(live) as connection:
        connection.sendall(POST + b"Content-Length: %d\r\n\r\n" % SENT)
        status, _, _ = read_answer(connection)
        assert status == 413
        time.sleep(2.5)  # longer than the service waits for a part that nobody wants
        with pytest.raises(OSError, match=r"reset|Broken"):
            send_for(connection, 10.0)


def send_for(connection: socket.socket, seconds: float) -> None:
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        connection.sendall(bytes(1000))
        time.sleep(0.05)


def test_a_small_body_keeps_the_connection(live):
    answer = live.client.post("/v1/scanners", json={})
    assert answer.status_code == 422
    assert "connection" not in answer.headers
