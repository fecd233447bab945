"""Time as an observer can have seen it pass."""

import time
from collections.abc import Callable


class ObservedTime:
    """Seconds from one look to the next.

    An observer that was itself stopped, or whose machine slept, has seen nothing meanwhile: no look counts for more
    than `longest_s`.

    Parameters
    ----------
    longest_s
        What one look may count for.
    monotonic
        Seconds; for tests.
    """

    def __init__(self, longest_s: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._longest_s = longest_s
        self._monotonic = monotonic
        self._looked_at = monotonic()

    def look_s(self) -> float:
        """Since the last look."""
        before, self._looked_at = self._looked_at, self._monotonic()
        return min(self._looked_at - before, self._longest_s)
