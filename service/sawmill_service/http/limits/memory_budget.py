"""Memory of pictures and arrays: one budget, which callers use in turn."""

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from starlette.requests import ClientDisconnect

# Largest number of answers that are drawn at once, each in a thread: the API has 40 threads.
_MOST_DRAWN = 32
# What drawing takes besides the values: fonts, and what is computed for a stripe of an image.
_LEAST_BYTES = 12 * 2**20


class Reservation:
    """Bytes that an answer takes while it is drawn and sent.

    Attributes
    ----------
    granted : asyncio.Event
        Set once the budget has room for them.
    """

    def __init__(self, caller: str, size_bytes: int) -> None:
        self.caller, self.size_bytes = caller, size_bytes
        self.granted = asyncio.Event()


class MemoryBudget:
    """Memory of all answers that are drawn or sent; used by one event loop.

    An answer waits until there is room for it. Callers take turns, and a caller's answers come in their order. One
    caller has at most half of the budget; a single answer that needs more waits until its caller has nothing else.

    Parameters
    ----------
    most_bytes
        Size of the budget; a larger answer counts as all of it.

    Attributes
    ----------
    least_bytes : int
        Bytes of an answer besides those for its values.
    """

    def __init__(self, most_bytes: int) -> None:
        self.least_bytes = max(_LEAST_BYTES, most_bytes // _MOST_DRAWN)
        self._most_bytes = most_bytes
        self._held: Counter[str] = Counter()
        self._waiting: OrderedDict[str, deque[Reservation]] = OrderedDict()

    @asynccontextmanager
    async def reserved(
        self, caller: str, size_bytes: int, until_gone: Callable[[], Coroutine[Any, Any, None]]
    ) -> AsyncIterator[Reservation]:
        """Hold bytes within the block, once there is room for them.

        Parameters
        ----------
        caller
            Name of the sender of the request.
        size_bytes
            Peak of the memory that the answer takes, all copies included.
        until_gone
            Coroutine that ends when the client has gone, which ends the wait.

        Raises
        ------
        ClientDisconnect
            The client has gone.
        """
        reservation = Reservation(caller, min(size_bytes, self._most_bytes))
        self._waiting.setdefault(caller, deque()).append(reservation)
        try:
            self._grant()
            if not reservation.granted.is_set():
                await _first_of(reservation.granted.wait(), until_gone())
            if not reservation.granted.is_set():
                raise ClientDisconnect
            yield reservation
        finally:
            if reservation.granted.is_set():
                self.shrink(reservation, 0)
            else:
                self._remove(reservation)
                self._grant()

    def shrink(self, reservation: Reservation, size_bytes: int) -> None:
        """Give back what an answer no longer takes; it has `size_bytes` left, or less if it had less."""
        left_bytes = min(size_bytes, reservation.size_bytes)
        self._held[reservation.caller] -= reservation.size_bytes - left_bytes
        self._held += Counter()  # callers without anything are forgotten
        reservation.size_bytes = left_bytes
        self._grant()

    def _grant(self) -> None:
        while reservation := self._next():
            self._remove(reservation)
            self._held[reservation.caller] += reservation.size_bytes
            if reservation.caller in self._waiting:
                self._waiting.move_to_end(reservation.caller)
            reservation.granted.set()

    def _next(self) -> Reservation | None:
        """Return the next answer that has room; a small one does not overtake a large one of another caller."""
        for caller, (first, *_) in self._waiting.items():
            of_caller = self._held[caller]
            if of_caller and of_caller + first.size_bytes > self._most_bytes // 2:
                continue
            return first if self._held.total() + first.size_bytes <= self._most_bytes else None
        return None

    def _remove(self, reservation: Reservation) -> None:
        waiting = self._waiting[reservation.caller]
        waiting.remove(reservation)
        if not waiting:
            del self._waiting[reservation.caller]


async def _first_of(*coroutines: Coroutine[Any, Any, object]) -> None:
    """Return when the first of the coroutines ends, and cancel the rest."""
    tasks = [asyncio.ensure_future(coroutine) for coroutine in coroutines]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
