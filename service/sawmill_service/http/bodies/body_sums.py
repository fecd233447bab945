"""`Content-Digest` (RFC 9530): a body that was damaged on its way is refused."""

import hashlib
import hmac
from collections.abc import Mapping
from typing import Protocol

from starlette.datastructures import Headers
from starlette.types import Message, Receive

from sawmill_service.http.bodies.structured_fields import bytes_in, dictionary_in
from sawmill_service.http.problems import Refused

# By RFC 9530, 5: algorithms that still guard against whoever wants to change something; others are ignored.
ALGORITHMS = {"sha-256": hashlib.sha256, "sha-512": hashlib.sha512}


class _Hash(Protocol):
    def update(self, data: bytes, /) -> None:
        """Go on with more bytes."""

    def digest(self) -> bytes:
        """The sum."""


class BodySums:
    """Checks the bytes of one body as they come against its `Content-Digest` (RFC 9530).

    Parameters
    ----------
    headers
        Of the request.

    Raises
    ------
    Refused
        400 `bad-digest`: it cannot be read.
    """

    def __init__(self, headers: Headers) -> None:
        self._expected = digests_of(headers)
        self._sums: Mapping[str, _Hash] = {name: ALGORITHMS[name]() for name in self._expected}

    def __bool__(self) -> bool:
        """Whether there is any digest to check."""
        return bool(self._expected)

    def update(self, part: bytes) -> None:
        """Go on with more bytes."""
        for computed in self._sums.values():
            computed.update(part)

    def check(self) -> None:
        """Refuse what was damaged on its way."""
        for name, computed in self._sums.items():
            if not hmac.compare_digest(self._expected[name], computed.digest()):
                detail = f"the bytes that came have another {name} than Content-Digest says: send them again"
                raise Refused(400, "digest-mismatch", detail)


def checked(receive: Receive, headers: Headers) -> Receive:
    """Refuse a body that is another one than its `Content-Digest` says; what cannot be read of that, when it begins."""
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
    """Of `Content-Digest` (RFC 9530), those whose algorithm is known here.

    Raises
    ------
    Refused
        400 `bad-digest`: it cannot be read.
    """
    given = all_lines(headers, "content-digest") or ""
    members = dictionary_in(given)
    if members is None:
        raise _bad_digest(given)
    return {name: _digest(name, value) for name, value in members.items() if name in ALGORITHMS}


def all_lines(headers: Headers, name: str) -> str | None:
    """A header's value, of several lines all (RFC 9110, section 5.3)."""
    return ",".join(headers.getlist(name)) or None


def _digest(name: str, value: str) -> bytes:
    digest = bytes_in(value)
    if digest is None or len(digest) != ALGORITHMS[name]().digest_size:
        raise _bad_digest(f"{name}={value}")
    return digest


def _bad_digest(given: str) -> Refused:
    example = "sha-256=:47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU=:"
    return Refused(400, "bad-digest", f"Content-Digest must be as in {example}, not {given[:100]!r}")
