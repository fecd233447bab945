"""Bodies that arrive too slowly are refused, so that no request stays open for ever."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.http.problems import Refused


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
