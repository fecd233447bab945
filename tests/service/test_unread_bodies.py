"""What follows an answer that comes before the body of its request: without a network."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from starlette.responses import PlainTextResponse

from sawmill_service.http.bodies.unread_bodies import UnreadBodies

PART_BYTES = 2**10


def answered(receive: Callable[[], Awaitable[dict[str, Any]]], **bounds: Any) -> tuple[dict[str, str], list[Any]]:
    """Answer a request with a body without reading it, and return the headers and the parts of the answer."""
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    headers = bounds.pop("headers", {})
    scope = {"type": "http", "method": "POST", "headers": [(b"content-length", b"1000000000000")]}
    asyncio.run(UnreadBodies(PlainTextResponse("no", 401, headers), **bounds)(scope, receive, send))
    given = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return given, [(message["body"], message.get("more_body", False)) for message in sent[1:]]


def test_a_body_without_an_end_is_thrown_away_up_to_a_bound():
    received = 0

    async def receive() -> dict[str, Any]:
        nonlocal received
        received += PART_BYTES
        return {"type": "http.request", "body": bytes(PART_BYTES), "more_body": True}

    headers, parts = answered(receive, most_bytes=10 * PART_BYTES)
    assert headers["connection"] == "close"
    assert parts == [(b"no", True), (b"", False)]
    assert received == 11 * PART_BYTES


def test_a_body_that_stands_still_is_awaited_for_a_time():
    async def receive() -> dict[str, Any]:
        await asyncio.Event().wait()
        raise AssertionError

    assert answered(receive, longest_s=0.01)[1] == [(b"no", True), (b"", False)]


@pytest.mark.parametrize("last", [{"type": "http.request", "body": b"all"}, {"type": "http.disconnect"}])
def test_the_answer_ends_with_the_body_or_the_client(last):
    messages = [last, {"type": "http.request", "body": bytes(PART_BYTES), "more_body": True}]

    async def receive() -> dict[str, Any]:
        return messages.pop()

    assert answered(receive)[1] == [(b"no", True), (b"", False)]
    assert messages == []


def test_nothing_follows_an_answer_that_ends_the_connection_by_itself():
    async def receive() -> dict[str, Any]:
        raise AssertionError

    assert answered(receive, headers={"Connection": "close"})[1] == [(b"no", False)]
