"""Memory of pictures and arrays: one budget, which callers use in turn."""

import asyncio
import ctypes
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from starlette.requests import ClientDisconnect

# Largest number of answers that are drawn at once, each in a thread: the API has 40 threads.
_MOST_DRAWN = 32
# Memory of drawing besides the values: the page of a side view, and what is computed for a stripe of an image.
_LEAST_BYTES = 16 * 2**20
# Options of glibc's mallopt (malloc.h). Larger blocks than the threshold go back to the system when they are freed.
_MALLOC_OPTIONS = {"M_ARENA_MAX": (-8, 2), "M_MMAP_THRESHOLD": (-3, 2**20)}


def return_freed_memory() -> None:
    """Let this process return the memory of images; glibc would keep 0.3 GB of it. Other C libraries return it."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        for option, value in _MALLOC_OPTIONS.values():
            library.mallopt(option, value)


class Reservation:
    """Memory of one answer; `granted` is set once the budget has room for it."""

    def __init__(self, caller: str, size_bytes: int) -> None:
        self.caller, self.size_bytes, self.granted = caller, size_bytes, asyncio.Event()


class MemoryBudget:
    """Memory of all answers that are drawn or sent; used by one event loop.

    An answer waits until there is room for it. Callers take turns, and a caller's answers come in their order. One
    caller has at most half of the budget; an answer that needs more waits until its caller has nothing else.
    """

    def __init__(self, most_bytes: int) -> None:
        self.least_bytes = max(_LEAST_BYTES, most_bytes // _MOST_DRAWN)
        self._most_bytes = most_bytes
        self._held: Counter[str] = Counter()
        # In the order of the callers' turns.
        self._waiting: dict[str, list[Reservation]] = {}

    @asynccontextmanager
    async def reserved(
        self, caller: str, size_bytes: int, until_gone: Callable[[], Coroutine[Any, Any, None]]
    ) -> AsyncIterator[Reservation]:
        """Hold memory within the block, once there is room for it."""
        reservation = Reservation(caller, min(size_bytes, self._most_bytes))
        self._waiting.setdefault(caller, []).append(reservation)
        self._grant()
        waits = [asyncio.ensure_future(wait) for wait in (reservation.granted.wait(), until_gone())]
        try:
            try:
                await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for wait in waits:
                    wait.cancel()
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
        """Give back all memory of an answer but `size_bytes`."""
        given_back = max(0, reservation.size_bytes - size_bytes)
        reservation.size_bytes -= given_back
        self._held[reservation.caller] -= given_back
        self._held += Counter()  # callers without memory are forgotten
        self._grant()

    def _grant(self) -> None:
        """Give room to waiting answers; a small one does not overtake a large one that waits for another caller."""
        for caller, (first, *_) in self._waiting.items():
            held = self._held[caller]
            if held and held + first.size_bytes > self._most_bytes // 2:
                continue
            if self._held.total() + first.size_bytes <= self._most_bytes:
                self._remove(first)
                self._held[caller] += first.size_bytes
                first.granted.set()
                self._grant()
            return

    def _remove(self, reservation: Reservation) -> None:
        """Let an answer no longer wait, and its caller's turn be the last one."""
        waiting = self._waiting.pop(reservation.caller)
        waiting.remove(reservation)
        if waiting:
            self._waiting[reservation.caller] = waiting
