"""Bodies that come slowly, part by part, without a network."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import httpx
import pytest

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
