"""Detection of running attempts that have fallen silent, by this observer's monotonic clock alone."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from sawmill_platform.attempts.observed_time import ObservedTime
from sawmill_platform.jobs.job_store import Pulse

# Multiple of the time between two looks that a late look may count for.
_LONGEST_LOOK = 2.0


@dataclass
class _Silence:
    """Time in which an attempt was seen without a new heartbeat, and with a cancellation that it did not receive."""

    pulse: Pulse
    seconds: float = 0.0
    unheard_s: float = 0.0


class LeaseObserver:
    """Observer of running attempts, which compares each look with the looks before; a restarted attempt counts from 0.

    Parameters
    ----------
    lease_s
        Silence after which a lease has run out.
    cancel_s
        Silence after which an attempt is taken not to receive its cancellation.
    look_s
        Time between two calls of `silent`.
    monotonic
        Clock that returns seconds; for tests.
    """

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
