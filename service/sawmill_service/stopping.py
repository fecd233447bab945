"""Shutdown of the service, its effect on open requests, and messages to systemd with `Type=notify`: sd_notify(3)."""

import asyncio
import math
import os
import signal
import socket
import time
from collections.abc import Callable, Mapping
from types import FrameType

import structlog
import uvicorn
from starlette.types import Message, Receive

from sawmill_service.http.problems import Refused


class ServiceManager:
    """Sender of states, and of signs of life at half of the interval after which their absence counts as a hang."""

    def __init__(
        self, environment: Mapping[str, str] = os.environ, *, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock_s = clock_s
        self._address = environment.get("NOTIFY_SOCKET", "")
        watched = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._period_s = int(environment.get("WATCHDOG_USEC", 0)) / 2e6 if watched else 0.0
        self._due = clock_s() if self._period_s else math.inf

    def report(self, state: str) -> None:
        """Send a state, as `READY=1`; log a state that cannot be sent."""
        if not self._address:
            return
        # An address in Linux's abstract namespace begins with a zero byte.
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as line:
                line.sendto(state.encode(), address)
        except OSError as error:
            structlog.get_logger().warning("state-not-reported", state=state, reason=str(error))

    def show_life(self) -> None:
        """Send a sign of life if one is due; the service's loop calls this several times a second while it runs."""
        now_s = self._clock_s()
        if now_s >= self._due:
            self._due = now_s + self._period_s
            self.report("WATCHDOG=1")


# Times after the first signal. A body or an answer that takes longer would delay the end as long as its client likes.
BODIES_S = 2.0
SHUTDOWN_S = 3.0
# Time for requests that wait for the database, which give up after five seconds (`database/database.py`).
_ANSWERS_S = 9
_POLL_S = 0.25


class Stopping:
    """State of the shutdown for open requests: streams end with an event, and incomplete bodies are refused."""

    def __init__(self) -> None:
        self.begun = False
        self._refusing = False
        self._waiting: set[asyncio.Timeout] = set()

    def begin(self) -> None:
        """Let streams end at their next poll, within a quarter of a second."""
        self.begun = True

    def refuse_bodies(self) -> None:
        """Refuse the requests that still wait for a part of a body."""
        waiting, self._refusing = () if self._refusing else self._waiting, True
        for limit in waiting:
            limit.reschedule(asyncio.get_running_loop().time())

    async def sleep(self, time_s: float) -> None:
        """Sleep, but not much longer than until the shutdown begins."""
        while time_s > 0.0 and not self.begun:
            await asyncio.sleep(min(time_s, _POLL_S))
            time_s -= _POLL_S

    async def next_part(self, receive: Receive) -> Message:
        """Return the next part of a body."""
        try:
            async with asyncio.timeout(0.0 if self._refusing else None) as limit:
                self._waiting.add(limit)
                try:
                    return await receive()
                finally:
                    self._waiting.discard(limit)
        except TimeoutError:
            detail = "the service stops, and the body has not come whole: send it again in a moment"
            raise Refused(503, "stopping", detail, {"Retry-After": "5", "Connection": "close"}) from None


class Server(uvicorn.Server):
    """Uvicorn server that ends in order: open requests get an answer, and no client delays the end for long."""

    def __init__(self, config: uvicorn.Config, stopping: Stopping, manager: ServiceManager) -> None:
        config.timeout_graceful_shutdown = _ANSWERS_S
        super().__init__(config)
        self._stopping, self._manager = stopping, manager

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, and report that the service answers."""
        await super().startup(sockets)
        self._manager.report("READY=1")

    async def on_tick(self, counter: int) -> bool:
        """Show the service manager that the service lives."""
        self._manager.show_life()
        return await super().on_tick(counter)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:  # noqa: ARG002 - uvicorn's names
        """Begin to end at the first signal; cut off open connections at the second Ctrl-C."""
        if self.should_exit and sig == signal.SIGINT:
            asyncio.get_running_loop().call_soon_threadsafe(self._cut_off)
        self.should_exit = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Let streams report the end, bodies come and answers go, each within its time."""
        loop = asyncio.get_running_loop()
        self._manager.report("STOPPING=1")
        self._stopping.begin()
        loop.call_later(BODIES_S, self._stopping.refuse_bodies)
        loop.call_later(SHUTDOWN_S, self._cut_off)
        await super().shutdown(sockets)

    def _cut_off(self) -> None:
        self._stopping.refuse_bodies()
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()
