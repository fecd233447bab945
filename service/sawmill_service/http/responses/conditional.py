"""Conditional requests and ranges (RFC 9110, sections 13 and 14)."""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from fastapi import Response
from starlette.datastructures import Headers

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
        detail = f"the file has {size_bytes} bytes, so {header[:100]!r} is beyond its end"
        raise Refused(416, "range-beyond-end", detail, {"Content-Range": f"bytes */{size_bytes}"})
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
