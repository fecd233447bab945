"""Orderly end of a watcher by SIGTERM or Ctrl-C."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

_LOOK_S = 0.1


class Stopped(Exception):  # noqa: N818 - no error
    """The watcher was asked to end."""


class Stop:
    """Flag of a requested end, which a signal handler may set at any moment."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise `Stopped` if the end was requested."""
        if self.asked:
            raise Stopped

    def sleep(self, seconds: float) -> None:
        """Sleep, or raise `Stopped` within a moment."""
        until_s = time.monotonic() + seconds
        while True:
            self.check()
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                return
            time.sleep(min(_LOOK_S, left_s))

    @contextmanager
    def on_signals(self) -> Iterator[None]:
        """Request the end of the block at SIGTERM and SIGINT."""
        before = {number: signal.signal(number, self._ask) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _ask(self, *_: object) -> None:
        self.asked = True
