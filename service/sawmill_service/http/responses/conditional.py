"""Conditional requests and ranges (RFC 9110, sections 13 and 14), and the sha256 of answers for entity tags.

With `If-Match`, two editors do not undo each other: what a `PUT` replaces has a tag.
"""

import asyncio
import hashlib
import os
import re
import threading
from base64 import b64encode
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import nullcontext
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Annotated, TypeVar

from fastapi import Depends, Header, Response
from fastapi.concurrency import run_in_threadpool
from starlette.datastructures import Headers

from sawmill_contracts.retention import Retention
from sawmill_contracts.scanners import ScannerSpec, StoredScanner
from sawmill_contracts.schedules import Schedule, ScheduleSpec
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.webhooks import Webhook
from sawmill_platform.database.paging import Check
from sawmill_platform.errors import StorageUnavailable
from sawmill_platform.files.verified_results import identity_of, regular_status
from sawmill_service.http.document.described_answers import Responses, refuses
from sawmill_service.http.problems import Refused

# An answer that needs a key is kept by its client alone, which asks again each time.
CACHING = "private, no-cache"

_UNIT = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
# No file has more bytes than 18 digits can count, and Python refuses to read numbers of thousands of digits.
_SPAN = re.compile(r"(\d{0,18})-(\d{0,18})")


def check_conditions(headers: Headers, tag: str, modified: str | None = None) -> Response | None:
    """Return 304 for a client that has the answer already; None if the conditions let the answer be sent."""
    # In the order of section 13.2.2.
    required, held = _listed(headers, "if-match"), _listed(headers, "if-none-match")
    if required:
        if "*" not in required and (tag.startswith("W/") or tag not in required):
            _refuse_condition("If-Match", headers["if-match"], f"the ETag is {tag}")
    elif _is_newer(modified, headers.get("if-unmodified-since")):
        _refuse_condition("If-Unmodified-Since", headers["if-unmodified-since"], f"Last-Modified is {modified}")
    if held:
        is_held = "*" in held or tag.removeprefix("W/") in {each.removeprefix("W/") for each in held}
    else:
        is_held = _is_newer(modified, headers.get("if-modified-since")) is False
    return Response(status_code=304, headers={"ETag": tag, "Cache-Control": CACHING}) if is_held else None


def spans_of(headers: Headers, size_bytes: int, tag: str) -> Sequence[slice]:
    """Return the requested ranges that the answer has, at least one; none if all of the answer is requested.

    A range in another unit, or of another version by `If-Range`, is ignored. A date in `If-Range` never matches: two
    versions may have been written within its second (section 13.1.5).
    """
    header = headers.get("range")
    if header is None or headers.get("if-range") not in {None, tag}:
        return []
    unit, is_given, listed = header.partition("=")
    if is_given and _UNIT.fullmatch(unit) and unit.lower() != "bytes":
        return []
    spans = [_span(part, size_bytes) for each in listed.split(",") if (part := each.strip(" \t"))]
    if unit.lower() != "bytes" or not spans or None in spans:
        raise Refused(
            400, "bad-range", f"Range must be as in bytes=0-1023, with at most 18 digits a number, not {header[:100]!r}"
        )
    there = [span for span in spans if span is not None and span.start < size_bytes]
    if not there:
        raise Refused(
            416,
            "range-beyond-end",
            f"the file has {size_bytes} bytes, so {header[:100]!r} is beyond its end",
            {"Content-Range": f"bytes */{size_bytes}"},
        )
    return there


def _span(part: str, size_bytes: int) -> slice | None:
    """Return the bytes that a part of the header names, which may begin at the end of the answer; None if malformed."""
    match = _SPAN.fullmatch(part)
    if match is None or part == "-":
        return None
    first, last = match.groups()
    if not first:
        return slice(max(0, size_bytes - int(last)), size_bytes)
    if last and int(last) < int(first):
        return None
    return slice(int(first), min(int(last) + 1, size_bytes) if last else size_bytes)


def _listed(headers: Headers, name: str) -> list[str]:
    """Return the entity tags of a header, or its `*`; none without the header. No tag of ours has a comma."""
    return [tag for line in headers.getlist(name) for each in line.split(",") if (tag := each.strip(" \t"))]


def _is_newer(modified: str | None, date_header: str | None) -> bool | None:
    """Return whether an answer was modified after the date of a condition; None if that is not known."""
    if modified is None or date_header is None:
        return None
    date = http_date(date_header)
    return None if date is None else parsedate_to_datetime(modified) > date


def http_date(text: str) -> datetime | None:
    """Read a date of HTTP in any of the three forms; return None for other texts, to be ignored (section 13.1.4)."""
    try:
        date = parsedate_to_datetime(text)
    except (ValueError, OverflowError):  # an overflow: numbers of more digits than a date can have
        return None
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def _refuse_condition(header: str, value: str, actual: str) -> None:
    raise Refused(412, "precondition-failed", f"{header} is {value[:100]!r}, but {actual}")


# Bytes of the pictures that are kept as they were sent; one picture may have a quarter.
_KEPT_BYTES = 16 * 1024**2
# A digest and its key have some 300 bytes.
_MOST_DIGESTS = 10_000
LARGE_FROM_BYTES = 8 * 1024**2


def tag_of(digest: bytes) -> str:
    """Return a strong entity tag."""
    return f'"{digest.hex()}"'


def repr_digest(digest: bytes) -> str:
    """Return the value of the header `Repr-Digest` (RFC 9530)."""
    return f"sha-256=:{b64encode(digest).decode()}:"


def key_of(path: str, made_of: Hashable) -> Hashable:
    """Return the key of a content that is made for a path from further values, which may be long."""
    return path, hashlib.sha256(repr(made_of).encode()).digest()


class Digests:
    """Digests of the newest answers by key, and small contents with their digests."""

    def __init__(self, *, large_from_bytes: int = LARGE_FROM_BYTES, read_at_once: int = 2) -> None:
        self._large_from_bytes = large_from_bytes
        self._lock = threading.Lock()
        self._reading: dict[Hashable, asyncio.Task[bytes]] = {}
        self._large = asyncio.Semaphore(read_at_once)
        self._digests: OrderedDict[Hashable, bytes] = OrderedDict()
        self._contents: OrderedDict[Hashable, bytes] = OrderedDict()
        self._kept_bytes = 0

    def known(self, key: Hashable) -> bytes | None:
        """Return the digest that was noted under a key."""
        with self._lock:
            return self._digests.get(key)

    def content(self, key: Hashable) -> bytes | None:
        """Return the content that was noted under a key, if it is still kept."""
        with self._lock:
            if key in self._contents:
                self._contents.move_to_end(key)
            return self._contents.get(key)

    def note(self, key: Hashable, content: bytes, *, keep: bool = True) -> bytes:
        """Note and return the digest of a content under a key; keep a small content with the digest."""
        digest = hashlib.sha256(content).digest()
        with self._lock:
            self._note(key, digest)
            if keep and key not in self._contents and len(content) <= _KEPT_BYTES // 4:
                self._contents[key] = content
                self._kept_bytes += len(content)
            while self._kept_bytes > _KEPT_BYTES:
                self._kept_bytes -= len(self._contents.popitem(last=False)[1])
        return digest

    async def of_file(self, path: Path, status: os.stat_result, compute: Callable[[Path], bytes]) -> bytes:
        """Return the digest of a file as it was when `status` was taken; the first time may take as long as reading it.

        If many requests need one file, one of them computes the digest, and the rest hold no thread.
        """
        key = (path, identity_of(status))
        if (digest := self.known(key)) is not None:
            return digest
        if key not in self._reading:
            self._reading[key] = asyncio.create_task(self._read(key, path, status, compute))
            self._reading[key].add_done_callback(lambda _: self._reading.pop(key))
        return await asyncio.shield(self._reading[key])  # a request that is cancelled leaves the task to the rest

    async def _read(self, key: Hashable, path: Path, status: os.stat_result, compute: Callable[[Path], bytes]) -> bytes:
        async with nullcontext() if status.st_size < self._large_from_bytes else self._large:
            digest = await run_in_threadpool(compute, path)
        if identity_of(regular_status(path)) != identity_of(status):
            raise StorageUnavailable(f"{path.name} was replaced while it was read: ask for it again")
        with self._lock:
            self._note(key, digest)
        return digest

    def _note(self, key: Hashable, digest: bytes) -> None:
        self._digests[key] = digest
        if len(self._digests) > _MOST_DIGESTS:
            self._digests.popitem(last=False)


Resource = TypeVar("Resource", bound=Contract)

# Fields that a `PUT` replaces; the others change without an editor.
_REPLACED: Mapping[type[Contract], frozenset[str]] = {
    StoredScanner: frozenset(ScannerSpec.model_fields),
    Schedule: frozenset(ScheduleSpec.model_fields),
    Webhook: frozenset({"url", "description", "events", "enabled"}),
    Retention: frozenset({"rules"}),
}

_TAG = {
    "description": "Tag of the fields that a `PUT` replaces: send it back as `If-Match`.",
    "schema": {"type": "string"},
    "required": True,
}
TAGGED: Responses = {200: {"headers": {"ETag": _TAG}}}  # answer with a resource that can be replaced
REPLACED: Responses = TAGGED | refuses("precondition-failed")  # answer of a route that replaces a resource


def precondition(
    if_match: Annotated[
        str | None,
        Header(
            max_length=1000,
            description="The `ETag` that was read: 412 if the resource was replaced since. Default: replace it anyway.",
        ),
    ] = None,
) -> Check[Contract]:
    """Return a function that refuses the request (412) if the stored resource is not the one that was read."""
    headers = Headers({} if if_match is None else {"If-Match": if_match})

    def check(resource: Contract) -> None:
        check_conditions(headers, edit_tag(resource))

    return check


ThePrecondition = Annotated[Check[Contract], Depends(precondition)]


def tagged(response: Response, resource: Resource) -> Resource:
    """Set the tag of an answer with a resource that can be replaced, and return the resource."""
    response.headers["ETag"] = edit_tag(resource)
    return resource


def edit_tag(resource: Contract) -> str:
    """Return the tag of the fields of a resource that an editor replaces."""
    replaced = resource.model_dump_json(include=set(_REPLACED[type(resource)]))
    return f'"{hashlib.sha256(replaced.encode()).hexdigest()[:32]}"'
