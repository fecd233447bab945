"""Feed of events that is read once for all streams of this process, however many clients follow."""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import Header
from fastapi.concurrency import run_in_threadpool

from sawmill_platform.contracts.events import Event
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.ledger.event_reader import EventReader
from sawmill_platform.ledger.events import Events

LARGEST_NUMBER = 2**53  # of an event: larger integers are not exact in JavaScript

# Header `Last-Event-ID` of every stream of events.
LastEventId = Annotated[
    int | None,
    Header(
        alias="Last-Event-ID",
        ge=0,
        le=LARGEST_NUMBER,
        description="The `id` of the last event that the client has seen, as browsers send it by themselves: the "
        "stream continues from there. Without this header the stream starts now.",
        examples=[0],
    ),
]

_BATCH = 500


@dataclass(frozen=True)
class StreamTimes:
    """Times of the streams of events and of the pages that follow one, in seconds."""

    alive_s: float = 5.0  # silence after which `alive` is sent
    access_s: float = 30.0  # time between two checks of the caller's key: a stream ends this soon after its key
    # lost_s, silent_s: times without a connection, and without an event on one, after which a page says that its data
    # may be old. A lost connection is restored within a second.
    lost_s: float = 4.0
    silent_s: float = 12.0


class EventFeed:
    """Reader of the table of events for all streams, no more often than for one; used by one event loop."""

    def __init__(
        self, events: Events, poll_s: float, *, kept: int = 2000, patience_s: float = 3.0, forgotten_s: float = 60.0
    ) -> None:
        self._events, self._poll_s = events, poll_s
        self._patience_s, self._forgotten_s = patience_s, forgotten_s
        self._reader: EventReader | None = None
        self._recent: deque[Event] = deque(maxlen=kept)
        # `_recent` has the events after the first number up to the second; `_reader` is ahead while a thread reads.
        self._complete_from = self._complete_through = 0
        self._polled_at_s = float("-inf")
        self._polling_since_s: float | None = None
        self._away = False

    async def start(self, after: int | None) -> int:
        """Return the number of the event after which a new stream follows."""
        newest = await run_in_threadpool(self._events.newest_number)
        if after is not None and after <= newest:
            return after
        return (await run_in_threadpool(self._events.reader)).number

    async def after(self, number: int, scanner_id: str | None = None) -> tuple[int, Sequence[Event]]:
        """Return the events after a number, and the number up to which these events are complete."""
        await self._poll()
        polling_since_s = self._polling_since_s
        hangs = polling_since_s is not None and time.monotonic() - polling_since_s > self._patience_s
        if self._away or hangs:
            raise StorageUnavailable("the database does not answer")
        if self._reader is None:  # the first read, for another stream, has not ended
            return number, ()
        complete_from = self._complete_from  # a read for another stream may change it during the await
        if number >= complete_from:
            behind = [event for event in self._recent if event.number > number]
            through = max(number, self._complete_through)
        else:
            behind = await run_in_threadpool(
                self._events.following, number, through=complete_from, group_id=scanner_id, limit=_BATCH
            )
            through = behind[-1].number if len(behind) == _BATCH else complete_from
        return through, [event for event in behind if scanner_id in {None, event.group_id}]

    async def _poll(self) -> None:
        """Read new events, unless a read for another stream runs or has just ended."""
        since_s = time.monotonic() - self._polled_at_s
        if self._polling_since_s is not None or since_s < self._poll_s:
            return
        self._polling_since_s = time.monotonic()
        try:
            if self._reader is None or since_s > self._forgotten_s:
                self._reader = await run_in_threadpool(self._events.reader)
                self._recent.clear()
                self._complete_from = self._complete_through = self._reader.number
            self._keep(await run_in_threadpool(self._reader.read))
            self._polled_at_s, self._away = time.monotonic(), False
        except StorageUnavailable:
            self._away = True
            raise
        finally:
            self._polling_since_s = None

    def _keep(self, events: Sequence[Event]) -> None:
        for event in events:
            if len(self._recent) == self._recent.maxlen:
                self._complete_from = self._recent[0].number
            self._recent.append(event)
            self._complete_through = event.number
