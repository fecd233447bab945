"""Bodies that come slowly, part by part, without a network."""

import asyncio
from collections.abc import Sequence
from typing import Any

import httpx
import pytest

from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings

LENGTH = 40_000


@pytest.fixture
def hurried(seeded, store):
    """A service that waits for bodies for tenths of a second, where it waits for minutes otherwise."""
    settings = ServiceSettings(client_silence_s=0.3, body_grace_s=0.2, min_client_bytes_per_s=50_000.0)
    seeded.app = create_app(settings, store, print)
    return seeded


def upload(client: Any, parts: Sequence[bytes], pause_s: float) -> httpx.Response:
    async def body():
        for part in parts:
            yield part
            await asyncio.sleep(pause_s)

    return client.post("/v1/scans", params={"scanner_id": "example", "data": "counts"}, content=body())


@pytest.mark.parametrize(
    ("parts", "pause_s", "reason"),
    [([b"half", b"half"], 5.0, "nothing came for 0.3 s"), ([b"a"] * 20, 0.1, "bytes came in")],
    ids=["stands still", "a byte now and then"],
)
def test_a_body_that_comes_too_slowly_is_refused(hurried, store, parts, pause_s, reason):
    answer = upload(hurried, parts, pause_s)
    assert (answer.status_code, answer.json()["code"]) == (408, "slow-body")
    assert reason in answer.json()["detail"]
    assert answer.headers["Connection"] == "close"
    assert list((store.files.folder / "incoming").iterdir()) == []


def test_a_slow_line_is_fast_enough(hurried):
    # 80 kB/s for half a second, where at least 50 kB/s are asked for after 0.2 s.
    assert upload(hurried, [bytes(LENGTH // 5)] * 5, 0.1).status_code == 202
