"""Requests that are answered before their body has arrived whole."""

import asyncio
from contextlib import suppress

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


def has_body(headers: Headers) -> bool:
    """Return whether a request announces a body."""
    return headers.get("content-length", "0") != "0" or "transfer-encoding" in headers


class UnreadBodies:
    """Middleware that discards the rest of a body after the answer, within bounds, and ends the connection.

    A client that sends its whole body before it reads gets the answer. After an answer that ends the connection itself,
    the rest of the body is not read.

    Parameters
    ----------
    most_bytes, longest_s
        Bytes that are discarded, and the time for that in s, before the connection ends.
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
