"""What the bytes of an upload's body stand for: packed or not, with the checksums of RFC 9530, a file and no page."""

import hashlib
import hmac
import re
import zlib
from base64 import b64decode
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Protocol

from starlette.datastructures import Headers

from sawmill_service.problems import Refused

BYTES = "application/octet-stream"
# By RFC 9530, 5: algorithms that still guard against whoever wants to change something; others are ignored.
ALGORITHMS = {"sha-256": hashlib.sha256, "sha-512": hashlib.sha512}
_MEMBER = re.compile(r"\s*([a-z*][a-z0-9_.*-]*)\s*=\s*:([A-Za-z0-9+/]*={0,2}):\s*(?:;[^,]*)?")
# No file is a text that somebody says is one, nor a form; `curl --data-binary` calls any file a urlencoded form.
_NO_FILE = re.compile(r"text/.*|multipart/.*|application/json|application/xml|.*\+(json|xml)")
_PAGE = re.compile(rb"\s*<(!doctype\s+html|html|\?xml)", re.IGNORECASE)
_FORM = re.compile(rb"--[^\r\n]{1,70}\r\ncontent-disposition:\s*form-data", re.IGNORECASE)
_PIECE_BYTES = 2**20
# gzip packs a file of one value a thousandfold; measured counts and line integrals about twofold.
# Each member costs time of its own, even an empty one; programs that write many give each thousands of bytes.
_FREE_MEMBERS, _LEAST_MEMBER_BYTES = 100, 1024
_MOST_RATIO, _FREE_BYTES = 100, 16 * 2**20


class _Hash(Protocol):
    def update(self, data: bytes, /) -> None:
        """Go on with more bytes."""

    def digest(self) -> bytes:
        """The sum."""


class SentContent:
    """Unpacks and checks the bytes of one body.

    Parameters
    ----------
    headers
        Of the request.
    packed
        Whether they may be packed by gzip.
    begins
        Whether they are the file's first ones.

    Raises
    ------
    Refused
        415 `unsupported-media-type`, `unsupported-encoding`; 400 `bad-digest`.
    """

    def __init__(self, headers: Headers, *, packed: bool = True, begins: bool = True) -> None:
        check_media_type(headers.get("content-type", ""))
        encoding = (_all_lines(headers, "content-encoding") or "identity").strip().lower()
        if encoding not in ({"identity", "gzip", "x-gzip"} if packed else {"identity"}):
            detail = f"the body may come as it is{' or packed by gzip' if packed else ''}, not by {encoding[:100]!r}"
            accepted = {"Accept-Encoding": "gzip, identity" if packed else "identity"}
            raise Refused(415, "unsupported-encoding", detail, accepted)
        self._expected = digests_of(headers)
        self._sums: Mapping[str, _Hash] = {name: ALGORITHMS[name]() for name in self._expected}
        self._gzip = Gunzip() if encoding.endswith("gzip") else None
        self._begun = not begins

    @property
    def has_digest(self) -> bool:
        """Whether it must come whole to be known as right."""
        return bool(self._expected)

    def take(self, part: bytes) -> Iterator[bytes]:
        """The file's bytes in a part of what was sent."""
        for computed in self._sums.values():
            computed.update(part)
        for piece in [part] if self._gzip is None else self._gzip.unpack(part):
            if not self._begun:
                check_first_bytes(piece)
            self._begun = True
            yield piece

    def end(self) -> None:
        """Refuse what was damaged on its way."""
        for name, computed in self._sums.items():
            if not hmac.compare_digest(self._expected[name], computed.digest()):
                detail = f"the bytes that came have another {name} than Content-Digest says: send them again"
                raise Refused(400, "digest-mismatch", detail)
        if self._gzip is not None:
            self._gzip.end()


class Gunzip:
    """Unpacks gzip, of one or more members, within bounds."""

    def __init__(self) -> None:
        self._member: Any = None  # typeshed names no type for it
        self._taken = self._given = self._members = 0

    def unpack(self, part: bytes) -> Iterable[bytes]:
        """What a part holds, in pieces.

        Raises
        ------
        Refused
            400 `bad-encoding`: it is no gzip. 413 `packed-too-well`: it would become far longer than any scan.
        """
        self._taken += len(part)
        while part:
            self._member = self._member or zlib.decompressobj(wbits=31)
            try:
                piece = self._member.decompress(part, _PIECE_BYTES)
            except zlib.error as error:
                raise Refused(400, "bad-encoding", f"the body is not what gzip packed: {error}") from error
            self._count(len(piece))
            if piece:
                yield piece
            part = self._member.unused_data if self._member.eof else self._member.unconsumed_tail
            if self._member.eof:
                self._member = None
                self._count_member()

    def end(self) -> None:
        """Refuse what broke off."""
        if self._member is not None:
            raise Refused(400, "bad-encoding", "the body ends in the middle of what gzip packed: send it again")

    def _count_member(self) -> None:
        self._members += 1
        if self._members > _FREE_MEMBERS + self._taken // _LEAST_MEMBER_BYTES:
            detail = f"the body is packed in {self._members} members, each of less than {_LEAST_MEMBER_BYTES} bytes"
            raise Refused(400, "bad-encoding", f"{detail}: pack the file at once")

    def _count(self, size: int) -> None:
        self._given += size
        if self._given > _FREE_BYTES + _MOST_RATIO * self._taken:
            detail = f"the body unpacks to more than {_MOST_RATIO} times its length: send the file as it is"
            raise Refused(413, "packed-too-well", detail)


def check_media_type(content_type: str) -> None:
    """Refuse a body that says of itself that it is no file, before a byte of it is read."""
    media_type = content_type.partition(";")[0].strip().lower()
    if _NO_FILE.fullmatch(media_type):
        detail = f"the body must be the file's bytes alone, as {BYTES}, not {media_type[:100]!r}"
        raise Refused(415, "unsupported-media-type", detail, {"Accept": BYTES})


def check_first_bytes(first: bytes) -> None:
    """Refuse a page or a form that was sent as a file."""
    found = "a page (HTML or XML)" if _PAGE.match(first) else "a form" if _FORM.match(first) else None
    if found:
        detail = f"the body is {found}, not a file of measurements: send the file's bytes alone, as {BYTES}"
        raise Refused(415, "unsupported-media-type", detail, {"Accept": BYTES})


def digests_of(headers: Headers) -> dict[str, bytes]:
    """Of `Content-Digest` (RFC 9530), those whose algorithm is known here.

    Raises
    ------
    Refused
        400 `bad-digest`: it cannot be read.
    """
    given = _all_lines(headers, "content-digest")
    members = [] if given is None else [_MEMBER.fullmatch(member) for member in given.split(",")]
    found = dict[str, bytes]()
    for member in members:
        if member is None:
            raise _bad_digest(given)
        if member[1] in ALGORITHMS:
            found[member[1]] = _decoded(member[1], member[2])
    return found


def _all_lines(headers: Headers, name: str) -> str | None:
    """A header's value, of several lines all (RFC 9110, section 5.3)."""
    return ",".join(headers.getlist(name)) or None


def _decoded(name: str, text: str) -> bytes:
    try:
        value = b64decode(text, validate=True)
    except ValueError:
        value = b""
    if len(value) != ALGORITHMS[name]().digest_size:
        raise _bad_digest(f"{name}=:{text}:")
    return value


def _bad_digest(given: str | None) -> Refused:
    example = "sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"
    return Refused(400, "bad-digest", f"Content-Digest must be as in {example}, not {(given or '')[:100]!r}")
