"""Periodic duties, with any engine that runs the jobs."""

import threading
import time
from collections.abc import Callable

import structlog

from sawmill_platform.attempts.patience import LeaseObserver
from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_platform.job_service_store import JobServiceStore
from sawmill_platform.workers.logs import going_on
from sawmill_platform.workers.settings import ExecutionSettings, process_name

# Seconds by which a clock may be off without a message: far more than the difference of clocks set over a network.
TOLERABLE_S = 5.0
# Seconds between two rounds of the duties whose limits are hours and days.
SELDOM_S = 60.0


Duty = Callable[[], object]


class Housekeeping:
    """Thread that handles leases, clocks, uploads and old data; other packages add duties of a round.

    Parameters
    ----------
    store
        Store; several processes may look after the same one.
    settings
        Settings with the periods.
    stop
        Event that ends the thread.
    monotonic
        Clock of the periods, seconds; leases have their own (`LeaseObserver`).
    """

    def __init__(
        self,
        store: JobServiceStore,
        settings: ExecutionSettings,
        stop: threading.Event,
        *,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monotonic = monotonic
        self._store = store
        self._settings = settings
        self._stop = stop
        # A live worker receives a cancellation with its next heartbeat.
        cancel_s = settings.heartbeat_s + settings.housekeeping_s
        self._leases = LeaseObserver(settings.lease_s, cancel_s, settings.housekeeping_s)
        self._clock_is_off = self._folder_is_away = False
        self._outages_said = set[str]()
        self._leftovers = store.leftovers(grace_s=settings.leftovers_s)
        self._seldom_due_s = monotonic()
        self._thread = threading.Thread(target=self._loop, name="housekeeping", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def join(self) -> None:
        """Wait for the end of the thread, after `stop` was set."""
        self._thread.join()

    def once(self) -> None:
        """Do everything that is due now; a duty that fails does not prevent the other duties.

        An outage is logged for the first duty that it delays, once in `SELDOM_S`.
        """
        duties = self.duties()
        if self._folder_is_ours():
            duties += self.duties_with_files()
        if (now_s := self._monotonic()) >= self._seldom_due_s:
            self._seldom_due_s = now_s + SELDOM_S
            self._outages_said.clear()
            duties += self.seldom_duties()
        for duty in duties:
            with going_on("housekeeping-put-off", said=self._outages_said, duty=duty.__name__.strip("_")):
                duty()

    def duties(self) -> list[Duty]:
        """Return the duties of each round."""
        return [
            self._take_back_silent,
            self._compare_clocks,
            self._store.repeats.forget_old,
            self._store.fill_spare_room,
        ]

    def duties_with_files(self) -> list[Duty]:
        """Return the duties of each round that need the data folder in its place."""
        return [self._remove_uploads, self._remove_leftovers]

    def seldom_duties(self) -> list[Duty]:
        """Return the duties of one round in `SELDOM_S`."""
        return [self._store.webhooks.forget_deliveries]

    def _folder_is_ours(self) -> bool:
        """Return whether files may be examined and removed, and log once if not.

        In another data folder all files would be leftovers.
        """
        try:
            self._store.check_folder()
            self._store.files.check_writable()
        except (StorageUnavailable, OSError) as error:
            if not self._folder_is_away:
                structlog.get_logger().warning("files-not-looked-after", reason=str(error))
            self._folder_is_away = True
            return False
        self._folder_is_away = False
        return True

    def _take_back_silent(self) -> None:
        """Take jobs from workers without heartbeats; not from workers that could not write a heartbeat in an outage."""
        try:
            silent = list(self._leases.silent(self._store.jobs.pulses()))
            # A check that can only read would count the silence of an outage.
            suspect = next(self._leases.suspects(), None)
            if suspect is not None:
                self._store.jobs.is_silent_still(suspect)
            for pulse in silent:
                job = self._store.jobs.take_back(pulse, retries=self._settings.retries)
                if job is not None:
                    structlog.get_logger().warning(
                        "lease-expired", job_id=job.id, attempt=job.attempt, losses=job.losses, state=job.state.value
                    )
        except (StorageFull, StorageUnavailable):
            self._leases.forget()
            raise

    def _compare_clocks(self) -> None:
        """Log once that this machine's clock is off, and again after it was right; no decision uses this clock."""
        off_s = self._store.clock_off_s()
        was_off, self._clock_is_off = self._clock_is_off, abs(off_s) > TOLERABLE_S
        if self._clock_is_off and not was_off:
            structlog.get_logger().warning("clock-off", off_s=round(off_s, 1))
            self._store.events.clock_off(process_name(), off_s)

    def _remove_uploads(self) -> None:
        """Remove uploads that nobody continues."""
        for upload_id in self._store.uploads.remove_expired():
            structlog.get_logger().info("upload-expired", upload_id=upload_id)

    def _remove_leftovers(self) -> None:
        removed = self._leftovers.remove_some()
        if removed:
            first = str(removed[0].relative_to(self._store.files.folder))
            structlog.get_logger().info("leftovers-removed", number=len(removed), first=first)

    def _loop(self) -> None:
        while not self._stop.wait(self._settings.housekeeping_s):
            with going_on("housekeeping-round-lost"):
                self.once()
