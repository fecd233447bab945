"""Content of an upload's body: packed by gzip or not, and a file, not a page or a form.

A request may be answered before its body has arrived whole, also because it arrives too slowly.
"""

import asyncio
import re
import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.http.bodies.body_sums import BodySums, all_lines
from sawmill_service.http.middleware import Middleware
from sawmill_service.http.problems import Refused

BYTES = "application/octet-stream"
# A body that is declared as text or as a form is no file; `curl --data-binary` declares any file as a urlencoded form.
_NO_FILE = re.compile(r"text/.*|multipart/.*|application/json|application/xml|.*\+(json|xml)")
_PAGE = re.compile(rb"(?:\xef\xbb\xbf)?\s*<(!doctype\s+html|html|\?xml)", re.IGNORECASE)
_FORM = re.compile(rb"--[^\r\n]{1,70}\r\ncontent-disposition:\s*form-data", re.IGNORECASE)
# The type that curl declares for `-d` and for `--data-binary`; `-d` removes the ends of lines. Of this number of random
# bytes one ends a line with a probability of 1 - 1e-14.
_DATA, _BYTES_WITH_A_LINE_END = "application/x-www-form-urlencoded", 4096
_PIECE_BYTES = 2**20
# gzip packs a file of one value a thousandfold; measured counts and line integrals about twofold.
# Each member costs time, even an empty one; programs that write many members give each thousands of bytes.
_FREE_MEMBERS, _LEAST_MEMBER_BYTES = 100, 1024
_MOST_RATIO, _FREE_BYTES = 100, 16 * 2**20


class FirstBytes:
    """Check of the first bytes of a file, in pieces of any size."""

    NUMBER = 1024

    def __init__(self) -> None:
        self._seen = b""

    def look(self, piece: bytes) -> None:
        """Refuse a page or a form that was sent as a file."""
        if len(self._seen) == self.NUMBER:
            return
        self._seen += piece[: self.NUMBER - len(self._seen)]
        kind = "a page (HTML or XML)" if _PAGE.match(self._seen) else "a form" if _FORM.match(self._seen) else None
        if kind:
            raise Refused(
                415,
                "unsupported-media-type",
                f"the body is {kind}, not a file of measurements: send the file's bytes alone, as {BYTES}",
                {"Accept": BYTES},
            )


class SentContent:
    """Reader that unpacks and checks the bytes of one body."""

    def __init__(self, headers: Headers, *, packed: bool = True, begins: bool = True) -> None:
        media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
        if _NO_FILE.fullmatch(media_type):
            detail = f"the body must be the file's bytes alone, as {BYTES}, not {media_type[:100]!r}"
            raise Refused(415, "unsupported-media-type", detail, {"Accept": BYTES})
        encoding = (all_lines(headers, "content-encoding") or "identity").strip().lower()
        if encoding not in ({"identity", "gzip", "x-gzip"} if packed else {"identity"}):
            detail = f"the body may come as it is{' or packed by gzip' if packed else ''}, not by {encoding[:100]!r}"
            accepted = {"Accept-Encoding": "gzip, identity" if packed else "identity"}
            raise Refused(415, "unsupported-encoding", detail, accepted)
        self._sums = BodySums(headers)
        self._gzip = Gunzip() if encoding.endswith("gzip") else None
        self._first = FirstBytes() if begins else None
        self._stripped = media_type == _DATA
        self._taken_bytes = 0

    @property
    def has_digest(self) -> bool:
        """True if the body has a digest, which can be checked only when it has arrived whole."""
        return bool(self._sums)

    def take(self, part: bytes) -> Iterator[bytes]:
        """Yield the file's bytes that a part of the body holds."""
        self._sums.update(part)
        self._taken_bytes += len(part)
        self._stripped = self._stripped and not (b"\n" in part or b"\r" in part)
        for piece in [part] if self._gzip is None else self._gzip.unpack(part):
            if self._first is not None:
                self._first.look(piece)
            yield piece

    def end(self) -> None:
        """Refuse a body that was damaged in transit, or by its sender."""
        if self._stripped and self._taken_bytes >= _BYTES_WITH_A_LINE_END:
            raise Refused(
                415,
                "unsupported-media-type",
                "the body has no end of a line, as curl's -d removes them: send the file by --data-binary @FILE",
                {"Accept": BYTES},
            )
        self._sums.check()
        if self._gzip is not None:
            self._gzip.end()


class Gunzip:
    """Reader that unpacks gzip of one or more members, within bounds.

    Zeros after the last member are skipped, as by gzip(1): RFC 1952 has none, but programs that write whole blocks add
    them.
    """

    def __init__(self) -> None:
        self._padded = False
        self._member: Any = None  # typeshed names no type for it
        self._taken = self._given = self._members = 0

    def unpack(self, part: bytes) -> Iterable[bytes]:
        """Yield the bytes that a part holds, in pieces."""
        self._taken += len(part)
        while part:
            if self._member is None and self._members and (self._padded or part[0] == 0):
                self._padded = True
                if part.strip(b"\0"):
                    raise Refused(400, "bad-encoding", "after the zeros that follow what gzip packed, more bytes come")
                return
            self._member = self._member or zlib.decompressobj(wbits=31)
            try:
                piece = self._member.decompress(part, _PIECE_BYTES)
            except zlib.error as error:
                raise Refused(400, "bad-encoding", f"the body is not what gzip packed: {error}") from error
            self._given += len(piece)
            if self._given > _FREE_BYTES + _MOST_RATIO * self._taken:
                raise Refused(
                    413,
                    "packed-too-well",
                    f"the body unpacks to more than {_MOST_RATIO} times its length: send the file as it is",
                )
            if piece:
                yield piece
            part = self._member.unused_data if self._member.eof else self._member.unconsumed_tail
            if self._member.eof:
                self._member = None
                self._members += 1
                if self._members > _FREE_MEMBERS + self._taken // _LEAST_MEMBER_BYTES:
                    detail = (
                        f"the body is packed in {self._members} members, each of less than {_LEAST_MEMBER_BYTES} bytes"
                    )
                    raise Refused(400, "bad-encoding", f"{detail}: pack the file at once")

    def end(self) -> None:
        """Refuse a body that breaks off, and an empty file."""
        if self._member is not None:
            raise Refused(400, "bad-encoding", "the body ends in the middle of what gzip packed: send it again")
        if not self._given:
            raise empty_body()


def empty_body() -> Refused:
    """Make the refusal of a file of no bytes."""
    return Refused(422, "empty-body", "the body is empty: send the file's bytes as the body")


# What is discarded of a body after the answer.
_MOST_UNREAD_BYTES, _LONGEST_UNREAD_S = 2**26, 30.0


def has_body(headers: Headers) -> bool:
    """Return whether a request announces a body."""
    return headers.get("content-length", "0") != "0" or "transfer-encoding" in headers


class UnreadBodies(Middleware):
    """Middleware that discards the rest of a body after the answer, within bounds, and ends the connection.

    A client that sends its whole body before it reads gets the answer. After an answer that ends the connection itself,
    the rest of the body is not read.
    """

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        if not has_body(Headers(scope=scope)):
            await self.app(scope, receive, send)
            return
        came_whole = unread = answered = False

        async def receive_noted() -> Message:
            nonlocal came_whole
            message = await receive()
            came_whole = not message.get("more_body", False)
            return message

        async def send_all_but_the_end(message: Message) -> None:
            nonlocal unread, answered
            if message["type"] == "http.response.start" and not came_whole:
                headers = MutableHeaders(scope=message)
                unread = "connection" not in headers
                headers["Connection"] = "close"
            elif unread and not message.get("more_body", False):
                message, answered = {**message, "more_body": True}, True
            await send(message)

        await self.app(scope, receive_noted, send_all_but_the_end)
        if answered:
            with suppress(TimeoutError):
                async with asyncio.timeout(_LONGEST_UNREAD_S):
                    received = 0
                    while not came_whole and received <= _MOST_UNREAD_BYTES:
                        received += len((await receive_noted()).get("body", b""))
            await send({"type": "http.response.body", "body": b""})


class SlowBodies(Middleware):
    """Middleware that refuses a body that stops, or arrives at less than the least mean rate.

    Only the time in which the service waited for the body counts: writing to a slow disk is not the client's fault.
    """

    def __init__(self, app: ASGIApp, *, silence_s: float, grace_s: float, least_bytes_per_s: float) -> None:
        super().__init__(app)
        self.silence_s, self.grace_s, self.least_bytes_per_s = silence_s, grace_s, least_bytes_per_s

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self.app(scope, self._in_time(receive), send)

    def _in_time(self, receive: Receive) -> Receive:
        waited_s, received, complete = 0.0, 0, False

        async def receive_in_time() -> Message:
            nonlocal waited_s, received, complete
            if complete:
                return await receive()
            began = asyncio.get_running_loop().time()
            message = await self._part(receive)
            waited_s += asyncio.get_running_loop().time() - began
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if not complete and waited_s > self.grace_s and received < self.least_bytes_per_s * waited_s:
                raise _slow(f"{received} bytes came in {waited_s:.0f} s, and {self.least_bytes_per_s:g} a second must")
            return message

        return receive_in_time

    async def _part(self, receive: Receive) -> Message:
        try:
            async with asyncio.timeout(self.silence_s):
                return await receive()
        except TimeoutError:
            raise _slow(f"nothing came for {self.silence_s:g} s") from None


def _slow(reason: str) -> Refused:
    return Refused(408, "slow-body", f"the body comes too slowly ({reason}): send it again", {"Connection": "close"})
