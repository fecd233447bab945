"""Bodies that come slowly, part by part, without a network."""

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any

import httpx
import pytest
import uvicorn

from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings


@pytest.fixture
def waiting(seeded, store) -> Callable[..., Any]:
    """Make a service that waits for bodies as the bounds say."""

    def make(**bounds: float) -> Any:
        seeded.app = create_app(ServiceSettings(**bounds), store, print)
        return seeded

    return make


def upload(client: Any, body: AsyncIterator[bytes]) -> httpx.Response:
    return client.post("/v1/scans", params={"scanner_id": "example", "data": "counts"}, content=body)


async def standing_still() -> AsyncIterator[bytes]:
    yield b"half"
    await asyncio.Event().wait()


async def byte_by_byte() -> AsyncIterator[bytes]:
    for _ in range(20):
        await asyncio.sleep(0.01)
        yield b"a"


@pytest.mark.parametrize(
    ("bounds", "body", "reason"),
    [
        ({"client_silence_s": 0.3}, standing_still, "nothing came for 0.3 s"),
        ({"body_grace_s": 0.05, "min_client_bytes_per_s": 1e6}, byte_by_byte, "bytes came in"),
    ],
    ids=["stands still", "a byte now and then"],
)
def test_a_body_that_comes_too_slowly_is_refused(waiting, store, bounds, body, reason):
    answer = upload(waiting(**bounds), body())
    assert (answer.status_code, answer.json()["code"]) == (408, "slow-body")
    assert reason in answer.json()["detail"]
    assert answer.headers["Connection"] == "close"
    assert list((store.files.folder / "incoming").iterdir()) == []


@pytest.mark.parametrize(
    "bounds",
    [{"body_grace_s": 600.0, "min_client_bytes_per_s": 1e6}, {"body_grace_s": 0.0, "min_client_bytes_per_s": 1e-3}],
    ids=["within the grace", "above the rate"],
)
def test_a_slow_line_is_fast_enough(waiting, bounds):
    assert upload(waiting(**bounds), byte_by_byte()).status_code == 202


def test_half_bodies_over_sockets_leave_nothing_without_a_proxy(waiting, store):
    app = waiting(client_silence_s=0.3).app
    head = b"POST /v1/scans?scanner_id=example&data=counts HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100\r\n\r\n"
    server = uvicorn.Server(uvicorn.Config(app, http="h11", ws="none", lifespan="off", log_config=None))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        try:
            clients = [socket.create_connection(listening.getsockname(), timeout=60) for _ in range(20)]
            for client in clients:
                client.sendall(head + b"half")
            answers = []
            for client in clients:
                with client, client.makefile("rb") as answer:
                    answers.append(answer.read())
        finally:
            server.should_exit = True
            thread.join(60)
    assert [b'"code":"slow-body"' in answer for answer in answers] == [True] * 20
    assert list((store.files.folder / "incoming").iterdir()) == []
