"""What has to be done now and then, whichever engine runs the jobs."""

import threading

import structlog

from worker.execution.settings import ExecutionSettings
from worker.storage.errors import StorageError
from worker.storage.store import Store


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
        self._thread = threading.Thread(target=self._loop, name="housekeeping", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the end, after `stop` was set."""
        self._thread.join()

    def once(self) -> None:
        """Everything that is due now."""
        log = structlog.get_logger()
        for job in self._store.jobs.requeue_expired(max_attempts=self._settings.max_attempts):
            log.warning("lease-expired", job=job.id, attempt=job.attempt, worker=job.worker, state=job.state.value)
        for run in self._store.schedules.run_due():
            log.info("schedule-ran", **run.model_dump(mode="json"))
        self._store.files.remove_leftovers()

    def _loop(self) -> None:
        while not self._stop.wait(self._settings.housekeeping_s):
            try:
                self.once()
            except (StorageError, OSError):
                structlog.get_logger().exception("housekeeping-put-off")
