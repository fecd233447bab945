"""SIGTERM and Ctrl-C end a watcher in order."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

_LOOK_S = 0.1


class Stopped(Exception):  # noqa: N818 - no error
    """The watcher was asked to end."""


class Stop:
    """Whether it was. A flag alone: what a handler of a signal may set at any moment."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise `Stopped` where it was asked to end."""
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
        """Have SIGTERM and SIGINT ask for the block's end."""
        before = {number: signal.signal(number, self._ask) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _ask(self, *_: object) -> None:
        self.asked = True
