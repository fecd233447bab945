"""What has to be done now and then, whichever engine runs the jobs."""

import threading
import time

import structlog

from sawmill_worker.execution.logs import going_on
from sawmill_worker.execution.settings import ExecutionSettings
from sawmill_worker.storage.errors import StorageFull, StorageUnavailable
from sawmill_worker.storage.store import Store


class Housekeeping:
    """A thread that sees to expired leases, due schedules and leftovers.

    Parameters
    ----------
    store
        Several processes may look after the same one.
    settings
        How often.
    stop
        Ends the thread.
    """

    def __init__(self, store: Store, settings: ExecutionSettings, stop: threading.Event) -> None:
        self._store = store
        self._settings = settings
        self._stop = stop
        self._leases_hold_until = 0.0
        self._thread = threading.Thread(target=self._loop, name="housekeeping", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the end, after `stop` was set."""
        self._thread.join()

    def once(self) -> None:
        """Everything that is due now; what cannot be done does not keep the rest from being done."""
        for duty in (self._requeue_expired, self._run_due_schedules, self._store.files.remove_leftovers):
            with going_on("housekeeping-put-off", duty=duty.__name__.strip("_")):  # nobody else does these duties
                duty()

    def _requeue_expired(self) -> None:
        """Give up on workers without heartbeats; not on those that could not renew their leases in an outage."""
        if time.monotonic() < self._leases_hold_until:
            return
        try:
            jobs = self._store.jobs.requeue_expired(retries=self._settings.retries)
        except (StorageFull, StorageUnavailable):
            self._leases_hold_until = time.monotonic() + self._settings.lease_s
            raise
        for job in jobs:
            structlog.get_logger().warning(
                "lease-expired", job=job.id, attempt=job.attempt, losses=job.losses, state=job.state.value
            )

    def _run_due_schedules(self) -> None:
        for run in self._store.schedules.run_due():
            structlog.get_logger().info("schedule-ran", **run.model_dump(mode="json"))

    def _loop(self) -> None:
        while not self._stop.wait(self._settings.housekeeping_s):
            with going_on("housekeeping-round-lost"):
                self.once()
