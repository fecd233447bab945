"""Pictures and arrays that are made for the request, and the memory that they take until they are sent.

All take their memory from one budget, which callers use in turn.
"""

import asyncio
import ctypes
import mimetypes
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine, Hashable, Iterable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import FileResponse, StreamingResponse
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive, Scope, Send

from sawmill_service.http.limits.rates import who
from sawmill_service.http.responses.answers import Png, describing, disposed, file, name_of, one_part
from sawmill_service.http.responses.conditional import Digests, check_conditions, key_of, tag_of
from sawmill_service.http.responses.waiting import until_gone

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


# Bytes that are sent at a time; a client that takes none of them within `client_silence_s` has gone.
_PIECE_BYTES = 64 * 1024


class Drawn(Response):
    """An answer that is made in a thread once there is memory for it; headers that are set here replace its own."""

    def __init__(self, request: Request, size_bytes: int, make: Callable[[], Response]) -> None:
        self.background = None
        self.init_headers()
        self._budget: MemoryBudget = request.app.state.memory_budget
        self._silence_s: float = request.app.state.settings.client_silence_s
        self._size_bytes, self._make = size_bytes, make

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request."""
        size_bytes = self._budget.least_bytes + self._size_bytes
        async with self._budget.reserved(who(scope), size_bytes, partial(until_gone, receive)) as reservation:
            answer = await run_in_threadpool(self._make)
            answer.headers.update(self.headers)
            if isinstance(answer, FileResponse):
                self._budget.shrink(reservation, 0)
            elif not isinstance(answer, StreamingResponse):
                self._budget.shrink(reservation, len(answer.body))
            await answer(scope, receive, partial(self._send_in_pieces, send))

    async def _send_in_pieces(self, send: Send, message: Message) -> None:
        body, more = message.get("body", b""), message.get("more_body", False)
        for start in range(0, len(body) or 1, _PIECE_BYTES):
            piece = bytes(body[start : start + _PIECE_BYTES])
            rest = {"body": piece, "more_body": more or start + _PIECE_BYTES < len(body)} if "body" in message else {}
            try:
                async with asyncio.timeout(self._silence_s):
                    await send({**message, **rest})
            except TimeoutError:
                raise ClientDisconnect from None


def picture(
    request: Request,
    made_of: Hashable,
    draw: Callable[[], bytes | str | tuple[bytes, Mapping[str, str]]],
    *,
    size_bytes: int = 0,
    answer: type[Response] = Png,
    save_as: str | None = None,
) -> Response:
    """Return a picture or an array, whole or a range of it, or 304 for a client that has it already.

    Parameters
    ----------
    made_of
        All values that it depends on.
    draw
        Function that makes it, or makes it with headers that describe it; not called if it is kept here, or the client
        is known to have it.
    size_bytes
        Peak of the memory in which it is made, besides what every answer takes.
    answer
        Type of the answer.
    save_as
        Name under which a browser saves it as a file, and it is not kept here. None: a browser shows it.
    """
    digests: Digests = request.app.state.digests
    key = key_of(request.url.path, made_of)
    digest = digests.known(key)
    if digest is not None and (unsent := check_conditions(request.headers, tag_of(digest))):
        return unsent
    suffix = mimetypes.guess_extension(answer.media_type or "") or ""
    name = save_as or f"{name_of(request).removesuffix(suffix)}{suffix}"

    def make() -> Response:
        # An equal request may have drawn it while this one waited.
        made = digests.content(key) or draw()
        content, headers = made if isinstance(made, tuple) else (made, {})
        content = content.encode() if isinstance(content, str) else content
        digest = digests.note(key, content, keep=save_as is None)
        if unsent := check_conditions(request.headers, tag_of(digest)):
            return unsent
        described = describing(digest, "attachment" if save_as else "inline", name)
        part, status, of_range = one_part(request.headers, content, described["ETag"])
        return answer(part, status, headers={**headers, **described, **of_range})

    return Drawn(request, 0 if digests.content(key) else size_bytes, make)


def kept_picture(request: Request, size_bytes: int, draw: Callable[[], Path]) -> Response:
    """Return a picture that `draw` stores at the first request, in `size_bytes` of memory, and finds from then on."""
    return Drawn(request, size_bytes, lambda: file(request, draw(), "image/png"))


def exported(
    request: Request,
    answer: type[Response],
    length: int,
    size_bytes: int,
    pieces: Iterable[bytes | memoryview],
    *,
    save_as: str,
) -> Response:
    """Return a file of `length` bytes that is written while it is sent, in `size_bytes` of memory."""
    headers = {
        "Content-Disposition": disposed("attachment", save_as),
        "Content-Length": str(length),
        "Cache-Control": "no-store",
    }
    return Drawn(request, size_bytes, lambda: StreamingResponse(pieces, media_type=answer.media_type, headers=headers))
