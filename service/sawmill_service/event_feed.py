"""What happens, read once for all streams of this process, however many tablets follow it."""

import time
from collections import deque
from collections.abc import Sequence
from typing import Annotated

from fastapi import Header
from fastapi.concurrency import run_in_threadpool

from sawmill_platform.contracts.events import Event
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.ledger.event_reader import EventReader
from sawmill_platform.ledger.events import Events

LARGEST_NUMBER = 2**53  # of an event; JavaScript counts no further

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
"""Of every stream of events."""

_KEPT = 2000  # of the newest; whoever is further behind reads the table itself
_BATCH = 500
# A look that takes longer, or a failed one, is an outage for every stream until one succeeds.
_PATIENCE_S = 3.0
# Nobody has followed for so long: starting anew is cheaper than reading on.
_FORGOTTEN_S = 60.0


class EventFeed:
    """Looks at the table as often as any one stream would; used by one event loop.

    Parameters
    ----------
    events
        The table.
    poll_s
        Time between two looks, while somebody follows.
    """

    def __init__(self, events: Events, poll_s: float) -> None:
        self._events, self._poll_s = events, poll_s
        self._reader: EventReader | None = None
        self._recent: deque[Event] = deque(maxlen=_KEPT)
        # What is kept begins behind the one number, and ends with the other; `_reader` is ahead while a thread reads.
        self._complete_from = self._complete_through = 0
        self._looked_at_s = float("-inf")
        self._looking_since_s: float | None = None
        self._away = False

    async def start(self, after: int | None) -> int:
        """From which number on a new stream follows.

        Parameters
        ----------
        after
            The last one that its client has seen; null: it follows what happens from now on, as does one that has seen
            what this database has not, for it was put back.

        Raises
        ------
        StorageUnavailable
            The database does not answer.
        """
        newest = await run_in_threadpool(self._events.newest_number)
        if after is not None and after <= newest:
            return after
        return (await run_in_threadpool(self._events.reader)).number

    async def after(self, number: int, scanner_id: str | None = None) -> tuple[int, Sequence[Event]]:
        """What there is behind a number by now, and the number through which that is all.

        Raises
        ------
        StorageUnavailable
            The database does not answer, or has not done so since somebody else's look failed or began to hang.
        """
        await self._look()
        if self._away or self._hangs():
            raise StorageUnavailable("the database does not answer")
        if self._reader is None:  # somebody else's first look has not ended
            return number, ()
        complete_from = self._complete_from  # another stream's look moves it meanwhile
        if number >= complete_from:
            behind = [event for event in self._recent if event.number > number]
            through = max(number, self._complete_through)
        else:
            behind = await run_in_threadpool(
                self._events.following, number, through=complete_from, group_id=scanner_id, limit=_BATCH
            )
            through = behind[-1].number if len(behind) == _BATCH else complete_from
        return through, [event for event in behind if scanner_id in {None, event.scanner_id}]

    async def _look(self) -> None:
        """Read on, unless somebody does or has just done so."""
        since_s = time.monotonic() - self._looked_at_s
        if self._looking_since_s is not None or since_s < self._poll_s:
            return
        self._looking_since_s = time.monotonic()
        try:
            if self._reader is None or since_s > _FORGOTTEN_S:
                self._reader = await run_in_threadpool(self._events.reader)
                self._recent.clear()
                self._complete_from = self._complete_through = self._reader.number
            self._keep(await run_in_threadpool(self._reader.read))
            self._looked_at_s, self._away = time.monotonic(), False
        except StorageUnavailable:
            self._away = True
            raise
        finally:
            self._looking_since_s = None

    def _hangs(self) -> bool:
        return self._looking_since_s is not None and time.monotonic() - self._looking_since_s > _PATIENCE_S

    def _keep(self, events: Sequence[Event]) -> None:
        for event in events:
            if len(self._recent) == _KEPT:
                self._complete_from = self._recent[0].number
            self._recent.append(event)
            self._complete_through = event.number
