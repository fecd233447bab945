"""Shapes of answers that several routes share: accepted work, pictures, files, and the 304 of both."""

import mimetypes
import re
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Annotated

from fastapi import Request, Response
from fastapi.responses import FileResponse
from pydantic import Field

from sawmill_service.digests import Digests, key_of, repr_digest, tag_of
from sawmill_service.problems import Refused
from sawmill_worker.contracts import patterns
from sawmill_worker.contracts.given import GivenTime, Queried
from sawmill_worker.contracts.jobs import Priority

# No file has more bytes than 18 digits can count, and Python refuses to read numbers of thousands of digits.
_SPAN = re.compile(r"\s*(\d{0,18})-(\d{0,18})\s*")
# Asked again each time, and kept by whoever asked alone: what needs a key is nobody else's.
CACHING = "private, no-cache"


class Png(Response):
    """A picture."""

    media_type = "image/png"


class Svg(Response):
    """A drawing."""

    media_type = "image/svg+xml"


class Hdf5(Response):
    """A file of arrays."""

    media_type = "application/x-hdf5"


AskedPriority = Annotated[
    Priority,
    Field(
        description="Jobs that somebody waits for go first. `batch`: after those, as what a schedule asks for. "
        "`background`: when no other could start, and it gives way to one."
    ),
]


class Paging(Queried):
    """Which page of a list."""

    after: str | None = Field(
        None,
        max_length=200,
        description="The `next` of the page before; nothing: the newest.",
        examples=["1772429400000000.example"],
        json_schema_extra={"pattern": patterns.CURSOR},
    )
    limit: Annotated[int, Field(ge=1, le=200, description="Items a page.")] = 50


class NumberedPaging(Paging):
    """Which page of a list of numbered entries."""

    after: str | None = Field(
        None,
        max_length=200,
        description="The `next` of the page before; nothing: the newest.",
        examples=["41"],
        json_schema_extra={"pattern": patterns.NUMBERED_CURSOR},
    )


class Dated(Paging):
    """Which page of a list, and of which span of time."""

    created_from: GivenTime | None = Field(
        None, description="The oldest moment, RFC 3339 with its offset.", examples=["2026-03-01T00:00:00+02:00"]
    )
    created_before: GivenTime | None = Field(
        None, description="Only what is older than this moment, RFC 3339.", examples=["2030-01-01T00:00:00Z"]
    )


def accept(response: Response, location: str, retry_after_s: int) -> None:
    """Set where accepted work will be found, and when to look."""
    response.headers["Location"] = location
    response.headers["Retry-After"] = str(retry_after_s)


def is_known(request: Request, tag: str) -> bool:
    """Whether the client claims to hold this very answer (RFC 9110, section 13.1.2)."""
    held = [item.strip().removeprefix("W/") for item in request.headers.get("if-none-match", "").split(",")]
    return tag in held or "*" in held


def not_modified(tag: str) -> Response:
    """The answer to a client that holds what it asks for."""
    return Response(status_code=304, headers={"ETag": tag, "Cache-Control": CACHING})


def describing(digest: bytes, disposition: str, name: str) -> dict[str, str]:
    """The headers of a download: its tag and digest, under which name it is saved, and how long it may be kept."""
    return {
        "ETag": tag_of(digest),
        "Repr-Digest": repr_digest(digest),
        "Content-Disposition": f'{disposition}; filename="{name}"',
        "Accept-Ranges": "bytes",
        "Cache-Control": CACHING,
    }


def picture(
    request: Request, drawn_from: Hashable, draw: Callable[[], bytes | str], *, answer: type[Response] = Png
) -> Response:
    """A PNG, or what else is made for a request, whole or a range; made only for a client that does not hold it.

    Parameters
    ----------
    drawn_from
        Everything that the picture depends on.
    draw
        Draws it; not called while the picture is kept, or known to be what the client holds.
    answer
        Its kind.
    """
    digests: Digests = request.app.state.digests
    key = key_of(request.url.path, drawn_from)
    digest = digests.known(key)
    if digest is not None and is_known(request, tag_of(digest)):
        return not_modified(tag_of(digest))
    content = digests.content(key)
    if content is None or digest is None:
        drawn = draw()
        content = drawn.encode() if isinstance(drawn, str) else drawn
        digest = digests.note(key, content)
        if is_known(request, tag_of(digest)):
            return not_modified(tag_of(digest))
    suffix = mimetypes.guess_extension(answer.media_type or "") or ""
    headers = describing(digest, "inline", f"{_name_of(request).removesuffix(suffix)}{suffix}")
    part, status = content, 200
    if span := span_of(request, len(content), headers["ETag"]):
        headers["Content-Range"] = f"bytes {span.start}-{span.stop - 1}/{len(content)}"
        part, status = content[span], 206
    return answer(part, status, headers=headers)


def span_of(request: Request, size_bytes: int, tag: str) -> slice | None:
    """The one range of a content that is asked for; None: the whole, as of several ranges or of another version.

    Raises
    ------
    Refused
        400 `bad-range`. 416 `range-beyond-end`.
    """
    header = request.headers.get("range")
    if header is None or request.headers.get("if-range") not in {None, tag}:
        return None
    _check_range(header, size_bytes)
    found = _SPAN.fullmatch(header.removeprefix("bytes="))
    if found is None:
        return None
    first, last = found.groups()
    if not first:
        return slice(max(0, size_bytes - int(last)), size_bytes)
    return slice(int(first), min(int(last) + 1, size_bytes) if last else size_bytes)


def file(request: Request, path: Path, media_type: str, *, save_as: str | None = None) -> Response:
    """A stored file, whole or in ranges, or 304 for a client that holds it; for a thread that may wait."""
    digests: Digests = request.app.state.digests
    try:
        status = path.stat()
        digest = digests.of_file(path, status)
    except FileNotFoundError:
        raise Refused(404, "file-missing", f"{path.name} is not there: it was not written, or was removed") from None
    tag = tag_of(digest)
    if is_known(request, tag):
        return not_modified(tag)
    disposition = "inline" if media_type.startswith("image/") else "attachment"
    headers = describing(digest, disposition, save_as or _name_of(request))
    answer = FileResponse(path, media_type=media_type, stat_result=status, headers=headers)
    # A range of another version of the file is answered with the whole (RFC 9110, section 13.1.5).
    held = request.headers.get("if-range")
    if "range" in request.headers and held in {None, tag, answer.headers["last-modified"]}:
        _check_range(request.headers["range"], status.st_size)
    return answer


def _name_of(request: Request) -> str:
    """Of a file that has none of its own, by its path: `scans-example-sinogram.png`."""
    return request.url.path.removeprefix("/v1/").strip("/").replace("/", "-")


def _check_range(header: str, size_bytes: int) -> None:
    """Refuse with a problem what `FileResponse` would refuse in plain text."""
    spans = [_SPAN.fullmatch(span) for span in header.removeprefix("bytes=").split(",")]
    named = [(span[1], span[2]) for span in spans if span is not None and _is_span(*span.groups())]
    if not header.startswith("bytes=") or len(named) < len(spans):
        raise Refused(
            400, "bad-range", f"Range must be as in bytes=0-1023, with at most 18 digits a number, not {header[:100]!r}"
        )
    if any(int(start) >= size_bytes if start else int(last) == 0 for start, last in named):
        beyond = f"the file has {size_bytes} bytes, so {header[:100]!r} is beyond its end"
        raise Refused(416, "range-beyond-end", beyond, {"Content-Range": f"bytes */{size_bytes}"})


def _is_span(first: str, last: str) -> bool:
    return int(first) <= int(last) if first and last else bool(first or last)
