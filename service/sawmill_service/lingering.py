"""An answer that comes before the body is read whole: how it reaches a client that is still sending.

A socket that is closed with bytes unread resets its connection, and a reset may take the answer from the client before
it was read. So the service closes in stages (RFC 9112, section 9.6): no more is written, and what comes is thrown away
for a while.
"""

import asyncio
from collections.abc import Callable
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

# Of a body that is not wanted: reading no more than this on is cheaper than another connection.
_SMALL_BYTES = 2**16
# A client that sends on for longer, or sends more, does not read its answer.
_LINGER_S, _SILENCE_S, _LINGER_BYTES = 30.0, 2.0, 2**30


class EarlyAnswers:
    """Announce the connection's end with an answer that comes before a large body, or one that waits for a 100."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http" or _is_small(Headers(scope=scope)):
            await self.app(scope, receive, send)
            return
        complete = False

        async def receive_noted() -> Message:
            nonlocal complete
            message = await receive()
            complete = complete or not message.get("more_body", False)
            return message

        async def send_closing(message: Message) -> None:
            if message["type"] == "http.response.start" and not complete:
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self.app(scope, receive_noted, send_closing)


def _is_small(headers: Headers) -> bool:
    if "transfer-encoding" in headers or "expect" in headers:
        return False
    declared = headers.get("content-length", "0")
    return declared.isdecimal() and int(declared) <= _SMALL_BYTES


class LingeringTransport(asyncio.Transport):
    """A transport that closes in stages where its client may still be sending.

    Parameters
    ----------
    transport
        The connection's own.
    loop
        It runs in.
    more_may_come
        Asked when it is closed.
    """

    def __init__(
        self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop, more_may_come: Callable[[], bool]
    ) -> None:
        super().__init__()
        self._transport, self._loop, self._more_may_come = transport, loop, more_may_come
        self._timers: list[asyncio.TimerHandle] = []
        self._left_bytes = _LINGER_BYTES
        self.lingers = False

    def close(self) -> None:
        """Send what is written; then close, at once or once the client has had the time to read it."""
        if self.is_closing():
            return
        if not self._more_may_come():
            self._transport.close()
            return
        self.lingers = True
        self._transport.write_eof()
        self._transport.resume_reading()
        self._timers = [self._loop.call_later(seconds, self._end) for seconds in (_LINGER_S, _SILENCE_S)]

    def throw_away(self, data: bytes) -> None:
        """Take what a client sends that nobody waits for."""
        self._left_bytes -= len(data)
        if self._left_bytes < 0:
            self._end()
            return
        self._timers.pop().cancel()
        self._timers.append(self._loop.call_later(_SILENCE_S, self._end))

    def forget(self) -> None:
        """The connection has ended."""
        for timer in self._timers:
            timer.cancel()

    def abort(self) -> None:
        """Close at once."""
        self._transport.abort()

    def is_closing(self) -> bool:
        """Whether it was closed; it may still throw away what comes."""
        return self.lingers or self._transport.is_closing()

    def write(self, data: Any) -> None:  # noqa: ANN401 - asyncio's own
        """Send, unless it was closed."""
        if not self.lingers:
            self._transport.write(data)

    def get_write_buffer_size(self) -> int:
        """Bytes that the system has not taken yet."""
        return self._transport.get_write_buffer_size()

    def get_extra_info(self, name: str, default: Any = None) -> Any:  # noqa: ANN401 - asyncio's own
        """About the socket."""
        return self._transport.get_extra_info(name, default)

    def resume_reading(self) -> None:
        """Read again."""
        self._transport.resume_reading()

    def _end(self) -> None:
        self._transport.close()
