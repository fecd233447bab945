"""Requests that are answered before their body has arrived whole, also because it arrives too slowly."""

import asyncio
from contextlib import suppress

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.http.problems import Refused


def has_body(headers: Headers) -> bool:
    """Return whether a request announces a body."""
    return headers.get("content-length", "0") != "0" or "transfer-encoding" in headers


class UnreadBodies:
    """Middleware that discards the rest of a body after the answer, within bounds, and ends the connection.

    A client that sends its whole body before it reads gets the answer. After an answer that ends the connection itself,
    the rest of the body is not read.
    """

    def __init__(self, app: ASGIApp, *, most_bytes: int = 2**26, longest_s: float = 30.0) -> None:
        self.app = app
        self.most_bytes, self.longest_s = most_bytes, longest_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or not has_body(Headers(scope=scope)):
            await self.app(scope, receive, send)
            return
        came_whole = unread = answered = False

        async def receive_noted() -> Message:
            nonlocal came_whole
            message = await receive()
            came_whole = not message.get("more_body", False)
            return message

        async def send_all_but_the_end(message: Message) -> None:
            nonlocal unread, answered
            if message["type"] == "http.response.start" and not came_whole:
                headers = MutableHeaders(scope=message)
                unread = "connection" not in headers
                headers["Connection"] = "close"
            elif unread and not message.get("more_body", False):
                message, answered = {**message, "more_body": True}, True
            await send(message)

        await self.app(scope, receive_noted, send_all_but_the_end)
        if answered:
            with suppress(TimeoutError):
                async with asyncio.timeout(self.longest_s):
                    received = 0
                    while not came_whole and received <= self.most_bytes:
                        received += len((await receive_noted()).get("body", b""))
            await send({"type": "http.response.body", "body": b""})


class SlowBodies:
    """Middleware that refuses a body that stops, or arrives at less than the least mean rate.

    Only the time in which the service waited for the body counts: writing to a slow disk is not the client's fault.
    """

    def __init__(self, app: ASGIApp, *, silence_s: float, grace_s: float, least_bytes_per_s: float) -> None:
        self.app = app
        self.silence_s, self.grace_s, self.least_bytes_per_s = silence_s, grace_s, least_bytes_per_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        await self.app(scope, self._in_time(receive) if scope["type"] == "http" else receive, send)

    def _in_time(self, receive: Receive) -> Receive:
        waited_s, received, complete = 0.0, 0, False

        async def receive_in_time() -> Message:
            nonlocal waited_s, received, complete
            if complete:
                return await receive()
            began = asyncio.get_running_loop().time()
            message = await self._part(receive)
            waited_s += asyncio.get_running_loop().time() - began
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if not complete and waited_s > self.grace_s and received < self.least_bytes_per_s * waited_s:
                raise _slow(f"{received} bytes came in {waited_s:.0f} s, and {self.least_bytes_per_s:g} a second must")
            return message

        return receive_in_time

    async def _part(self, receive: Receive) -> Message:
        try:
            async with asyncio.timeout(self.silence_s):
                return await receive()
        except TimeoutError:
            raise _slow(f"nothing came for {self.silence_s:g} s") from None


def _slow(reason: str) -> Refused:
    return Refused(408, "slow-body", f"the body comes too slowly ({reason}): send it again", {"Connection": "close"})
