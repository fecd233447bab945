"""`Content-Digest` (RFC 9530), by which a damaged body is refused, and structured fields (RFC 9651).

Among these are the headers of a part of an upload, by the draft "Resumable Uploads for HTTP".
"""

import hashlib
import hmac
import re
from base64 import b64decode
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from starlette.datastructures import Headers
from starlette.types import Message, Receive

from sawmill_platform.contracts.uploads import Upload
from sawmill_service.http.problems import Refused

# Algorithms that still protect against deliberate changes (RFC 9530, section 5); other algorithms are ignored.
ALGORITHMS = {"sha-256": hashlib.sha256, "sha-512": hashlib.sha512}


class _Hash(Protocol):
    def update(self, data: bytes, /) -> None:
        """Add more bytes."""

    def digest(self) -> bytes:
        """Return the digest."""


class BodySums:
    """Check of the bytes of one body against its `Content-Digest` (RFC 9530), as they arrive."""

    def __init__(self, headers: Headers) -> None:
        self._expected = digests_of(headers)
        self._sums: Mapping[str, _Hash] = {name: ALGORITHMS[name]() for name in self._expected}

    def __bool__(self) -> bool:
        """Return whether there is a digest to check."""
        return bool(self._expected)

    def update(self, part: bytes) -> None:
        """Add more bytes."""
        for computed in self._sums.values():
            computed.update(part)

    def check(self) -> None:
        """Refuse a body that was damaged in transit."""
        for name, computed in self._sums.items():
            if not hmac.compare_digest(self._expected[name], computed.digest()):
                raise Refused(
                    400,
                    "digest-mismatch",
                    f"the bytes that came have another {name} than Content-Digest says: send them again",
                )


def checked(receive: Receive, headers: Headers) -> Receive:
    """Refuse a body that does not match its `Content-Digest`, and at its start a `Content-Digest` that is malformed."""
    sums: BodySums | None = None

    async def receive_checked() -> Message:
        nonlocal sums
        sums = BodySums(headers) if sums is None else sums
        message = await receive()
        sums.update(message.get("body", b""))
        if message["type"] == "http.request" and not message.get("more_body", False):
            sums.check()
        return message

    return receive_checked


def digests_of(headers: Headers) -> dict[str, bytes]:
    """Return the digests of `Content-Digest` (RFC 9530) whose algorithm is known here, by algorithm."""
    header = all_lines(headers, "content-digest") or ""
    members = dictionary_in(header)
    if members is None:
        raise _bad_digest(header)
    return {name: _digest(name, value) for name, value in members.items() if name in ALGORITHMS}


def all_lines(headers: Headers, name: str) -> str | None:
    """Return a header's value, several lines joined by commas (RFC 9110, section 5.3)."""
    return ",".join(headers.getlist(name)) or None


def _digest(name: str, value: str) -> bytes:
    digest = bytes_in(value)
    if digest is None or len(digest) != ALGORITHMS[name]().digest_size:
        raise _bad_digest(f"{name}={value}")
    return digest


def _bad_digest(header: str) -> Refused:
    example = "sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"
    return Refused(400, "bad-digest", f"Content-Digest must be as in {example}, not {header[:100]!r}")


_KEY = r"[a-z*][a-z0-9_.*-]*"
_BARE = (
    r"(?:-?\d{1,12}\.\d{1,3}|-?\d{1,15}|@-?\d{1,15}|\?[01]"
    r"|%?\"(?:[ !#-\[\]-~]|\\[\"\\])*\"|:[A-Za-z0-9+/=]*:|[A-Za-z*][!#$%&'*+.^_`|~:/0-9A-Za-z-]*)"
)
# No field that this service reads has parameters; unknown ones are ignored (section 1.1).
_PARAMETERS = rf"(?:;[ ]*{_KEY}(?:={_BARE})?)*"
_ITEM = re.compile(rf"[ ]*({_BARE}){_PARAMETERS}[ ]*", re.ASCII)
_MEMBER = re.compile(rf"[ \t]*({_KEY})(?:=({_BARE}))?{_PARAMETERS}[ \t]*(,|$)", re.ASCII)


def count_in(text: str) -> int | None:
    """Read an item that is an integer (section 3.3.1) of 0 or more."""
    bare = _bare_in(text)
    return int(bare) if bare is not None and re.fullmatch(r"-0+|\d+", bare, re.ASCII) else None


def boolean_in(text: str) -> bool | None:
    """Read an item that is a boolean (section 3.3.6): `?1` or `?0`."""
    return {"?1": True, "?0": False}.get(_bare_in(text) or "")


def bytes_in(text: str) -> bytes | None:
    """Read an item that is a sequence of bytes (section 3.3.5), as in `:aGVsbG8=:`."""
    bare = _bare_in(text) or ""
    try:
        return b64decode(bare[1:-1], validate=True) if bare.startswith(":") else None
    except ValueError:
        return None


def dictionary_in(text: str) -> dict[str, str] | None:
    """Read a dictionary of items (section 3.2), each as it is written; the last item of a name counts."""
    members, at = dict[str, str](), 0
    if not text.strip(" \t"):
        return members
    while (member := _MEMBER.match(text, at)) is not None:
        members[member[1]] = member[2] or "?1"
        at = member.end()
        if not member[3]:
            return members
    return None


def _bare_in(text: str) -> str | None:
    item = _ITEM.fullmatch(text)
    return None if item is None else item[1]


Value = TypeVar("Value")

_MOST = 10**15 - 1  # largest integer in a structured field
_BYTES = {"type": "integer", "minimum": 0, "maximum": _MOST}


def _header(name: str, description: str, schema: dict[str, Any], *, required: bool = False) -> dict[str, Any]:
    return {"name": name, "in": "header", "description": description, "required": required, "schema": schema}


# Headers as the OpenAPI document describes them. A wrong one is answered with 400, unlike a field of a form.
HEADERS = [
    _header(
        "Upload-Offset",
        "Offset of the part's first byte: the number that `HEAD` gives.",
        _BYTES | {"examples": [0]},
        required=True,
    ),
    _header(
        "Upload-Complete",
        "`?1`: the part is the last one, and is refused where bytes would be missing after it.",
        {"type": "string", "pattern": r"^\?[01]$", "examples": ["?0"]},
    ),
    _header(
        "Upload-Length",
        "Number of bytes of the whole file: the part is refused where the upload was declared with another length.",
        _BYTES | {"examples": [1048576]},
    ),
]


@dataclass(frozen=True)
class AnnouncedPart:
    """A part that is announced by its headers."""

    offset_bytes: int  # position in the file at which the part begins
    part_bytes: int | None  # length of the part; None: not declared
    is_last: bool  # True if the sender declares that no bytes are missing after the part
    size_bytes: int | None  # length of the whole file, as the sender declares it; None: not declared

    def check(self, upload: Upload) -> None:
        """Refuse a part that does not fit the upload, before a byte is read."""
        if self.size_bytes not in {None, upload.size_bytes}:
            detail = f"upload {upload.id!r} was declared with {upload.size_bytes} bytes, and not with Upload-Length"
            raise Refused(400, "inconsistent-length", f"{detail}, {self.size_bytes}")
        if self.part_bytes is not None:
            self.check_end(upload.size_bytes - self.offset_bytes - self.part_bytes)

    def check_end(self, missing_bytes: int) -> None:
        """Refuse a last part after which bytes are missing."""
        if self.is_last and missing_bytes:
            detail = f"Upload-Complete: ?1 says that the part is the last one, but {missing_bytes} bytes are missing"
            raise Refused(400, "inconsistent-length", f"{detail} after it: send all, or ?0")


def announced_part(headers: Headers) -> AnnouncedPart:
    """Read the headers of a part."""
    offset_bytes = _read(headers, "Upload-Offset", count_in, "a count of bytes, as in 1048576")
    if offset_bytes is None:
        raise Refused(
            400,
            "bad-upload-header",
            "Upload-Offset is missing: it must say where the part begins, and HEAD gives that offset",
        )
    return AnnouncedPart(
        offset_bytes=offset_bytes,
        part_bytes=int(headers["content-length"]) if "content-length" in headers else None,  # digits, by the gate
        is_last=_read(headers, "Upload-Complete", boolean_in, "?1 or ?0") or False,
        size_bytes=_read(headers, "Upload-Length", count_in, "a count of bytes, as in 1048576"),
    )


def _read(headers: Headers, name: str, parse: Callable[[str], Value | None], right: str) -> Value | None:
    """Read one header; return None if it is missing."""
    lines = headers.getlist(name)
    if not lines:
        return None
    value = parse(", ".join(lines))
    if value is None:
        raise Refused(400, "bad-upload-header", f"{name} must be {right}, not {', '.join(lines)[:100]!r}")
    return value
