"""Rules for retries of jobs; the module is for settings as well, and so for processes that open no database."""

from dataclasses import dataclass

LONGEST_WAIT_S = 60.0


@dataclass(frozen=True)
class Retries:
    """Waits before retries after passing failures. Waits double from one to the next, up to a minute.

    Attributes
    ----------
    max_losses : int
        The loss that fails the job.
    loss_wait_s : float
        First wait after a loss, such as a process that was killed.
    outage_wait_s : float
        First wait after a full disk or a database that was away, which are no loss.
    """

    max_losses: int = 3
    loss_wait_s: float = 1.0
    outage_wait_s: float = 5.0
