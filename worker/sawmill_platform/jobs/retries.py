"""When jobs are tried again: known to settings as well, and so to processes that open no database."""

from dataclasses import dataclass

LONGEST_WAIT_S = 60.0


@dataclass(frozen=True)
class Retries:
    """When a job is tried again after a passing failure. Waits double from one to the next, up to a minute.

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
