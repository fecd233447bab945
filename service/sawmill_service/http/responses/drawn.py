"""Pictures and arrays that are made for the request, and the memory that they take until they are sent."""

import asyncio
import mimetypes
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import partial

from fastapi import Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import FileResponse, StreamingResponse
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive, Scope, Send

from sawmill_service.drawing import KeptPicture
from sawmill_service.http.limits.callers import who
from sawmill_service.http.limits.memory_budget import MemoryBudget
from sawmill_service.http.responses.answers import Png, describing, file, name_of, one_part
from sawmill_service.http.responses.conditional import check_conditions
from sawmill_service.http.responses.digests import Digests, key_of, tag_of
from sawmill_service.http.responses.waiting import until_gone

# A client that takes no piece within `client_silence_s` has gone.
_PIECE_BYTES = 64 * 1024


class Npy(Response):
    """An array, as NumPy stores it (`numpy.load`)."""

    media_type = "application/x-npy"


class Tiff(Response):
    """A stack of images."""

    media_type = "image/tiff"


class Nrrd(Response):
    """A volume with its place, as 3D Slicer reads it."""

    media_type = "application/x-nrrd"


class Drawn(Response):
    """An answer that is made in a thread once there is memory for it; headers that are set here replace its own.

    Parameters
    ----------
    request
        Request that it answers.
    size_bytes
        Peak of the memory in which the answer is made, all copies included.
    make
        Function that makes the answer.
    """

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
    drawn_from: Hashable,
    draw: Callable[[], bytes | str],
    *,
    size_bytes: int = 0,
    answer: type[Response] = Png,
) -> Response:
    """Return a picture, whole or a range of it, or 304 for a client that has the picture already.

    Parameters
    ----------
    drawn_from
        All values that the picture depends on.
    draw
        Function that draws the picture; not called if the picture is kept here, or the client is known to have it.
    size_bytes
        Peak of the memory in which the picture is drawn; the budget's least may be left out.
    answer
        Type of the answer.
    """

    def read() -> tuple[bytes, Mapping[str, str]]:
        drawn = draw()
        return drawn.encode() if isinstance(drawn, str) else drawn, {}

    suffix = mimetypes.guess_extension(answer.media_type or "") or ""
    save_as = f"{name_of(request).removesuffix(suffix)}{suffix}"
    return _made(request, drawn_from, size_bytes, read, answer=answer, disposition="inline", save_as=save_as)


def array(
    request: Request,
    made_of: Hashable,
    size_bytes: int,
    read: Callable[[], tuple[bytes, Mapping[str, str]]],
    *,
    save_as: str,
) -> Response:
    """Return an NPY file, or 304 for a client that has the file already.

    Parameters
    ----------
    made_of
        All values that the file depends on.
    size_bytes
        Peak of the memory in which the file is made.
    read
        Function that returns the file's content, and headers that describe it.
    save_as
        Name under which a browser saves the file.
    """
    return _made(request, made_of, size_bytes, read, answer=Npy, disposition="attachment", save_as=save_as, keep=False)


def _made(
    request: Request,
    made_of: Hashable,
    size_bytes: int,
    read: Callable[[], tuple[bytes, Mapping[str, str]]],
    *,
    answer: type[Response],
    disposition: str,
    save_as: str,
    keep: bool = True,
) -> Response:
    digests: Digests = request.app.state.digests
    key = key_of(request.url.path, made_of)
    digest = digests.known(key)
    if digest is not None and (unsent := check_conditions(request.headers, tag_of(digest))):
        return unsent

    def make() -> Response:
        # An equal request may have drawn it while this one waited.
        digest, content = digests.known(key), digests.content(key)
        headers: Mapping[str, str] = {}
        if content is None or digest is None:
            content, headers = read()
            digest = digests.note(key, content, keep=keep)
            if unsent := check_conditions(request.headers, tag_of(digest)):
                return unsent
        described = describing(digest, disposition, save_as)
        part, status, of_range = one_part(request.headers, content, described["ETag"])
        return answer(part, status, headers={**headers, **described, **of_range})

    return Drawn(request, 0 if digests.content(key) else size_bytes, make)


def kept_picture(request: Request, picture: KeptPicture) -> Response:
    """Return a picture that is drawn at the first request, and stored."""
    if picture.path.is_file():
        return file(request, picture.path, Png.media_type)
    return Drawn(request, picture.size_bytes, lambda: file(request, picture.draw(), Png.media_type))


def exported(
    request: Request,
    answer: type[Response],
    length: int,
    size_bytes: int,
    pieces: Iterable[memoryview],
    *,
    save_as: str,
) -> Response:
    """Return a file of `length` bytes that is written while it is sent, in `size_bytes` of memory."""
    headers = {
        "Content-Disposition": f'attachment; filename="{save_as}"',
        "Content-Length": str(length),
        "Cache-Control": "no-store",
    }
    return Drawn(request, size_bytes, lambda: StreamingResponse(pieces, media_type=answer.media_type, headers=headers))
