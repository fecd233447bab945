"""The duties of a mill's housekeeping: schedules, drift charts, alarms, retention and watched folders."""

import threading
import time
from collections.abc import Callable

import structlog

from sawmill_platform.workers.housekeeping import Duty, Housekeeping
from sawmill_platform.workers.logs import going_on
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_store.retention.retention_store import RetentionKeeper
from sawmill_store.store import Store
from sawmill_worker.watched_folders import WatchedFolders

# Seconds of a round in which drift charts go on, if they are many or are begun anew; leases wait for it.
DRIFT_S = 1.0
# Seconds of a round in which batches go by the rules of retention, at least one; leases wait for it.
RETENTION_S = 1.0


class MillHousekeeping(Housekeeping):
    """The housekeeping of a mill's store."""

    def __init__(
        self,
        store: Store,
        settings: ExecutionSettings,
        stop: threading.Event,
        *,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(store, settings, stop, monotonic=monotonic)
        self._mill = store
        self._retention = RetentionKeeper(store.database, store.files)
        self._watched_folders = WatchedFolders(store, stop, monotonic)

    def join(self) -> None:
        """Wait for the end of the thread and of what watches folders, after `stop` was set."""
        super().join()
        self._watched_folders.close()

    def duties(self) -> list[Duty]:
        """Return the duties of each round."""
        return [*super().duties(), self._run_due_schedules, self._follow_drift]

    def duties_with_files(self) -> list[Duty]:
        """Return the duties of each round in which the data folder is in its place."""
        watching = [self._watched_folders.look] if self._mill.settings.watch_folders else []
        return [*super().duties_with_files(), self._retire, *watching]

    def seldom_duties(self) -> list[Duty]:
        """Return the duties of one round in `SELDOM_S`."""
        return [*super().seldom_duties(), self._check_alarms]

    def _run_due_schedules(self) -> None:
        for run in self._mill.schedules.run_due():
            structlog.get_logger().info("schedule-ran", **run.model_dump(mode="json"))

    def _follow_drift(self) -> None:
        """Add the drift checks that have ended to their scanners' charts."""
        waiting, until_s = self._mill.drift_charts.waiting(), self._monotonic() + DRIFT_S
        if waiting:  # a worker that is asked for no drift check holds no NumPy
            from sawmill_calibration.drift_checks.baselines import follow  # noqa: PLC0415
        while waiting:
            going, waiting = waiting, []
            for scanner_id in going:
                with going_on("drift-chart-put-off", scanner_id=scanner_id):  # the others' go on
                    if self._mill.drift_charts.follow(scanner_id, follow) and self._monotonic() < until_s:
                        waiting.append(scanner_id)

    def _check_alarms(self) -> None:
        for what, alarm in self._mill.alarms.check():
            structlog.get_logger().warning(what, **alarm.model_dump(mode="json", exclude_none=True))

    def _retire(self) -> None:
        """Remove batches of what the rules of retention reach; the event of each says what went."""
        until_s = self._monotonic() + RETENTION_S
        while self._retention.remove_some() is not None and self._monotonic() < until_s:
            pass
