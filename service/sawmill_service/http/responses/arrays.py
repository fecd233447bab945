"""Answers that are arrays, sent in pieces, with a bound on the memory of all of them together."""

import threading
from collections.abc import AsyncIterator, Callable, Hashable, Iterable, Mapping

from fastapi import Request, Response
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from sawmill_service.http.limits.rates import too_many
from sawmill_service.http.responses.answers import describing, one_part
from sawmill_service.http.responses.conditional import check_conditions
from sawmill_service.http.responses.digests import Digests, key_of, tag_of

# Bytes of all arrays that are being read or sent: four slices of 4096 x 4096.
MOST_BYTES = 256 * 1024**2
_PIECE_BYTES = 256 * 1024
_RETRY_S = 1


class Npy(Response):
    """An array, as NumPy stores it (`numpy.load`)."""

    media_type = "application/x-npy"


class Tiff(Response):
    """A stack of images."""

    media_type = "image/tiff"


class Nrrd(Response):
    """A volume with its place, as 3D Slicer reads it."""

    media_type = "application/x-nrrd"


class HeldBytes:
    """Counter of the memory of answers until they are sent.

    Parameters
    ----------
    most
        Largest sum, in bytes; a single answer may have more.
    """

    def __init__(self, most: int = MOST_BYTES) -> None:
        self._most = most
        self._held = 0
        self._lock = threading.Lock()

    def take(self, size: int) -> None:
        """Count an answer.

        Raises
        ------
        Refused
            429 `too-many-requests`: other answers use the memory.
        """
        with self._lock:
            if self._held and self._held + size > self._most:
                detail = f"arrays of {self._held} bytes are being sent, {self._most} at most: ask again in a second"
                raise too_many(detail, _RETRY_S)
            self._held += size

    def give_back(self, size: int) -> None:
        """Subtract an answer that was sent."""
        with self._lock:
            self._held -= size


def array(
    request: Request, made_of: Hashable, size: int, read: Callable[[], tuple[bytes, Mapping[str, str]]], *, save_as: str
) -> Response:
    """Return an NPY file, or 304 for a client that has the file already.

    Parameters
    ----------
    made_of
        All values that the file depends on.
    size
        Bytes that are read for the file.
    read
        Function that returns the file's content, and headers that describe it.
    save_as
        Name under which a browser saves the file.
    """
    digests: Digests = request.app.state.digests
    held: HeldBytes = request.app.state.held_arrays
    key = key_of(request.url.path, made_of)
    digest = digests.known(key)
    if digest is not None and (unsent := check_conditions(request.headers, tag_of(digest))):
        return unsent
    held.take(size)
    try:
        content, headers = read()
        digest = digests.note(key, content, keep=False)
        if unsent := check_conditions(request.headers, tag_of(digest)):
            held.give_back(size)
            return unsent
        own = describing(digest, "attachment", save_as)
        part, status, of_range = one_part(request.headers, content, own["ETag"])
    except BaseException:
        held.give_back(size)
        raise
    # Fewer bytes may be sent than were read.
    counted = min(size, len(content))
    held.give_back(size - counted)
    described = {**headers, **own, **of_range, "Content-Length": str(len(part))}
    return _Sent(_pieces(part), Npy, described, status=status, held=held, counted=counted)


def exported(
    request: Request,
    answer: type[Response],
    length: int,
    largest_piece: int,
    pieces: Iterable[bytes],
    *,
    save_as: str,
) -> Response:
    """Return a file of `length` bytes that is written while it is sent, of which one piece is held at a time."""
    held: HeldBytes = request.app.state.held_arrays
    held.take(largest_piece)
    headers = {
        "Content-Disposition": f'attachment; filename="{save_as}"',
        "Content-Length": str(length),
        "Cache-Control": "no-store",
    }
    return _Sent(pieces, answer, headers, held=held, counted=largest_piece)


class _Sent(StreamingResponse):
    """An answer whose bytes are counted until the client has them, or is gone."""

    def __init__(
        self,
        pieces: AsyncIterator[bytes] | Iterable[bytes],
        answer: type[Response],
        headers: Mapping[str, str],
        *,
        status: int = 200,
        held: HeldBytes,
        counted: int,
    ) -> None:
        super().__init__(pieces, status, media_type=answer.media_type, headers=headers)
        self._held, self._counted = held, counted

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer the request."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._held.give_back(self._counted)


async def _pieces(content: bytes) -> AsyncIterator[bytes]:
    # The server takes a piece when the client has read the one before, so that the bytes are held once.
    for start in range(0, len(content), _PIECE_BYTES):
        yield content[start : start + _PIECE_BYTES]
