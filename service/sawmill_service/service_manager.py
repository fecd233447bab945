"""Messages to the program that started the service and watches it, as systemd with `Type=notify`: sd_notify(3).

Nothing is sent where the environment names no such program.
"""

import math
import os
import socket
import time
from collections.abc import Callable, Mapping

import structlog


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
