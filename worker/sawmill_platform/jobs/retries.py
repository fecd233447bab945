"""Rules for retries of jobs; the module is for settings as well, and so for processes that open no database."""

from dataclasses import dataclass

LONGEST_WAIT_S = 60.0


@dataclass(frozen=True)
class Retries:
    """Waits before retries after passing failures. Waits double from one to the next, up to a minute."""

    max_losses: int = 3
    loss_wait_s: float = 1.0
    outage_wait_s: float = 5.0
