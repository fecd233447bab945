"""Time limits of an attempt and of silence, by the monotonic clocks of its supervisor and of other observers."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from sawmill_platform.attempts.failures import endless_reader, not_begun, stalled, too_long
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of, reading_limit_s
from sawmill_platform.jobs.job_store import Pulse
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
    """Time limits of one attempt."""

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
        if self._reading_s is not None and self._begun and self._still_s >= self._reading_s:
            share = LEAST_SHARE if self._still_s >= self._stall_s else BUSY_SHARE
            if processor_s - self._used_s >= share * self._reading_s:
                detail = endless_reader(self._upload or "file", self._still_s)
                return Failure(kind=FailureKind.INPUT, code="broken-file", detail=detail)
        if self._still_s >= self._stall_s:
            return stalled(self._still_s, None if self._seen is None else self._seen.stage)
        return None


def _place(progress: Progress) -> tuple[str, float, int | None]:
    return progress.stage, progress.fraction, progress.generation


class ObservedTime:
    """Clock of the seconds from one look to the next.

    An observer that was itself stopped, or whose machine slept, has seen nothing in that time: no look counts for more
    than `longest_s`.
    """

    def __init__(self, longest_s: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._longest_s = longest_s
        self._monotonic = monotonic
        self._looked_at = monotonic()

    def look_s(self) -> float:
        """Return the seconds since the last look."""
        before, self._looked_at = self._looked_at, self._monotonic()
        return min(self._looked_at - before, self._longest_s)


# Multiple of the time between two looks that a late look may count for.
_LONGEST_LOOK = 2.0


@dataclass
class _Silence:
    """Time in which an attempt was seen without a new heartbeat, and with a cancellation that it did not receive."""

    pulse: Pulse
    seconds: float = 0.0
    unheard_s: float = 0.0


class LeaseObserver:
    """Observer of running attempts that compares each look with those before; a restarted attempt counts from 0."""

    def __init__(
        self, lease_s: float, cancel_s: float, look_s: float, *, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._lease_s = lease_s
        self._cancel_s = min(cancel_s, lease_s)
        self._time = ObservedTime(_LONGEST_LOOK * look_s + 1.0, monotonic)
        self._seen: dict[str, _Silence] = {}

    def silent(self, pulses: Iterable[Pulse]) -> Iterator[Pulse]:
        """Yield the attempts whose lease has run out, in their state at this look."""
        step_s, seen = self._time.look_s(), self._seen
        self._seen = {pulse.job_id: self._after(seen.get(pulse.job_id), pulse, step_s) for pulse in pulses}
        for silence in self._seen.values():
            if silence.seconds >= self._lease_s or silence.unheard_s >= self._cancel_s:
                yield silence.pulse

    def suspects(self) -> Iterator[Pulse]:
        """Return attempts silent for so long that it should be checked whether they could have sent a heartbeat."""
        return (silence.pulse for silence in self._seen.values() if silence.seconds >= self._cancel_s)

    def forget(self) -> None:
        """Restart the count: no attempt could have written a heartbeat."""
        self._seen = {}

    @staticmethod
    def _after(before: _Silence | None, pulse: Pulse, step_s: float) -> _Silence:
        if before is None or (before.pulse.attempt, before.pulse.beats) != (pulse.attempt, pulse.beats):
            return _Silence(pulse)
        unheard_s = before.unheard_s + step_s if before.pulse.cancel_requested else 0.0
        return _Silence(pulse, before.seconds + step_s, unheard_s)
