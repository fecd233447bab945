"""Time that an observer can have seen pass."""

import time
from collections.abc import Callable


class ObservedTime:
    """Clock of the seconds from one look to the next.

    An observer that was itself stopped, or whose machine slept, has seen nothing in that time: no look counts for more
    than `longest_s`.

    Parameters
    ----------
    longest_s
        Most that one look may count for.
    monotonic
        Clock that returns seconds; for tests.
    """

    def __init__(self, longest_s: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._longest_s = longest_s
        self._monotonic = monotonic
        self._looked_at = monotonic()

    def look_s(self) -> float:
        """Return the seconds since the last look."""
        before, self._looked_at = self._looked_at, self._monotonic()
        return min(self._looked_at - before, self._longest_s)
