"""When what failed is tried again."""

import time
from dataclasses import dataclass

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 60.0


@dataclass
class Backoff:
    """Waits longer after each failure."""

    until_s: float = 0.0
    wait_s: float = FIRST_WAIT_S

    def put_off(self, retry_after_s: float | None = None) -> None:
        """After a failure: at least for as long as was asked for."""
        self.until_s = time.monotonic() + max(self.wait_s, retry_after_s or 0.0)
        self.wait_s = min(2.0 * self.wait_s, LONGEST_WAIT_S)

    def over(self) -> None:
        """After a success."""
        self.wait_s = FIRST_WAIT_S

    @property
    def is_due(self) -> bool:
        """Whether it may be tried again."""
        return time.monotonic() >= self.until_s
