"""Time limits of an attempt and of a pause in its progress, by its supervisor's monotonic clock."""

import time
from collections.abc import Callable

from sawmill_platform.attempts.failures import endless_reader, not_begun, stalled, too_long
from sawmill_platform.attempts.observed_time import ObservedTime
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of, reading_limit_s
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_vocabulary import Progress

# Most that a late look may count for, in addition to two looks.
LATE_S = 5.0
# Time that a process has to start after its assignment: everything is imported, and compilation has a stage's name.
BEGIN_S = 60.0
# Share of the reading time for which a reader that loops had a core: half on a machine with twice as much to do as it
# has cores. Of a long pause a tenth tells a reader that loops from a process that waits for a disk or was stopped.
BUSY_SHARE, LEAST_SHARE = 0.5, 0.1


class Patience:
    """Time limits of one attempt.

    Parameters
    ----------
    kind
        Kind of the job, which declares the limits.
    settings
        Limits that override the limits of all kinds.
    upload_bytes
        Size of the uploaded file that the job reads; null: it reads none.
    monotonic
        Clock that returns seconds; for tests.
    """

    def __init__(
        self,
        kind: JobKind,
        settings: ExecutionSettings,
        *,
        upload_bytes: int | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        declared = declaration_of(kind)
        self._kind = kind
        self._limit_s = settings.time_limit_s or declared.time_limit_s
        self._stall_s = settings.stall_s or declared.stall_s
        self._upload = declared.upload
        self._reading_s = None if upload_bytes is None else min(reading_limit_s(upload_bytes), self._stall_s)
        self._time = ObservedTime(2.0 * settings.progress_s + LATE_S, monotonic)
        self._taken_s = self._still_s = 0.0
        self._used_s: float | None = None
        self._begun = False
        self._seen: Progress | None = None

    def heard(self, progress: Progress) -> None:
        """Take a report; a report that repeats stage, fraction and generation is no progress."""
        if self._seen is None or _place(progress) != _place(self._seen):
            self.moved()
        self._seen = progress

    def moved(self) -> None:
        """Note that the attempt has made progress, its start included."""
        self._begun = True
        self._still_s, self._used_s = 0.0, None

    def end(self, processor_s: float) -> Failure | None:
        """Return why the attempt has to be ended now; None if the attempt may continue."""
        step_s = self._time.look_s()
        self._taken_s += step_s
        self._still_s += step_s
        if self._taken_s >= self._limit_s:
            return too_long(self._kind, self._limit_s)
        if not self._begun and self._still_s >= min(BEGIN_S, self._stall_s):
            return not_begun(self._still_s)
        self._used_s = processor_s if self._used_s is None else self._used_s
        if self._reading_s is not None and self._begun and self._loops(processor_s - self._used_s, self._reading_s):
            detail = endless_reader(self._upload or "file", self._still_s)
            return Failure(kind=FailureKind.INPUT, code="broken-file", detail=detail)
        if self._still_s >= self._stall_s:
            return stalled(self._still_s, None if self._seen is None else self._seen.stage)
        return None

    def _loops(self, busy_s: float, reading_s: float) -> bool:
        share = LEAST_SHARE if self._still_s >= self._stall_s else BUSY_SHARE
        return self._still_s >= reading_s and busy_s >= share * reading_s


def _place(progress: Progress) -> tuple[str, float, int | None]:
    return progress.stage, progress.fraction, progress.generation
