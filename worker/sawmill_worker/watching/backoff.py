"""Waiting times between retries."""

import time
from dataclasses import dataclass

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 60.0


@dataclass
class Backoff:
    """A waiting time that grows with each failure."""

    until_s: float = 0.0
    wait_s: float = FIRST_WAIT_S

    def put_off(self, retry_after_s: float | None = None) -> None:
        """Start a longer wait after a failure, of at least `retry_after_s`."""
        self.until_s = time.monotonic() + max(self.wait_s, retry_after_s or 0.0)
        self.wait_s = min(2.0 * self.wait_s, LONGEST_WAIT_S)

    def over(self) -> None:
        """Reset the waiting time after a success."""
        self.wait_s = FIRST_WAIT_S

    @property
    def is_due(self) -> bool:
        """True if the next try may start."""
        return time.monotonic() >= self.until_s
