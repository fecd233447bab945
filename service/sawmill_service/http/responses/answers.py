"""Answers that several routes share: accepted work and files, with 304."""

import os
import re
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, cast
from urllib.parse import quote

from fastapi import Request, Response
from fastapi.responses import FileResponse
from pydantic import Field
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.given import Given, GivenTime
from sawmill_platform.contracts.jobs import Priority
from sawmill_platform.files.verified_results import compute_digest, regular_status
from sawmill_platform.keys.key_store import SESSION_LASTS
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.conditional import CACHING, Digests, check_conditions, repr_digest, spans_of, tag_of


def of_type(media_type: str, base: type[Response] = Response) -> type[Response]:
    """Make the class of answers of a type."""
    return type("Answer", (base,), {"media_type": media_type})


Png = of_type("image/png")
Jpeg = of_type("image/jpeg")
Svg = of_type("image/svg+xml")
Tiff = of_type("image/tiff")
Hdf5 = of_type("application/x-hdf5")
Npy = of_type("application/x-npy")
Nrrd = of_type("application/x-nrrd")

RequestPriority = Annotated[
    Priority,
    Field(
        description="Order of jobs: `interactive` goes first; `batch` next, as for jobs of a schedule; `background` "
        "starts when no other job could, and gives way to any other job."
    ),
]


def cursor(example: str, pattern: str) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a page's place in a list."""
    about = "The `next` of the page before. Default: the newest page."
    return Field(None, max_length=200, description=about, examples=[example], json_schema_extra={"pattern": pattern})


class Paging(Given):
    """Page of a list."""

    after: str | None = cursor("1772429400000000.example", patterns.CURSOR)
    limit: Annotated[int, Field(ge=1, le=200, description="Number of items a page.")] = 50
    fields: str | None = Field(
        None,
        exclude=True,  # `route_rules.py` reads it
        max_length=1000,
        pattern=r"^[a-z0-9_]+(,[a-z0-9_]+)*$",
        description="Fields of the items, with commas between, as `id,state`. Items then lack all others, also those "
        "that their schema requires. Default: all.",
    )


class NumberedPaging(Paging):
    """Page of a list of numbered entries."""

    after: str | None = cursor("41", patterns.NUMBERED_CURSOR)


class Dated(Paging):
    """Page of a list, and its span of time."""

    created_from: GivenTime | None = Field(
        None, description="Earliest time of creation, RFC 3339 with its offset.", examples=["2026-03-01T00:00:00+02:00"]
    )
    created_before: GivenTime | None = Field(
        None, description="Time before which the items were created, RFC 3339.", examples=["2030-01-01T00:00:00Z"]
    )


def accept(response: Response, location: str, retry_after_s: int) -> None:
    """Set the path of accepted work, and the time after which to ask."""
    response.headers["Location"] = location
    response.headers["Retry-After"] = str(retry_after_s)


def describing(digest: bytes, disposition: str, name: str) -> dict[str, str]:
    """Return the headers of a download: its tag and digest, the name to save it under, and how long it may be kept."""
    return {"ETag": tag_of(digest), "Repr-Digest": repr_digest(digest), **_saved(disposition, name)}


def disposed(disposition: str, name: str) -> str:
    """Return a `Content-Disposition` with a file's name: in ASCII, and where letters are lost, in full (RFC 6266)."""
    safe = re.sub(r'[\\/:*?"<>|;%\x00-\x1f]', "-", name)
    plain = unicodedata.normalize("NFKD", safe).encode("ascii", "ignore").decode()
    in_full = "" if plain == safe else f"; filename*=UTF-8''{quote(safe, safe='')}"
    return f'{disposition}; filename="{plain}"{in_full}'


def _saved(disposition: str, name: str) -> dict[str, str]:
    return {"Content-Disposition": disposed(disposition, name), "Accept-Ranges": "bytes", "Cache-Control": CACHING}


def unchanging(answer: Response) -> Response:
    """Let a browser keep an answer that never changes, without a further request, for as long as an idle session lasts.

    With another session or key, and after the logout, the browser requests it again.
    """
    answer.headers["Cache-Control"] = f"private, max-age={int(SESSION_LASTS.total_seconds())}, immutable"
    answer.headers["Vary"] = "Authorization, Cookie"
    return answer


def one_part(headers: Headers, content: bytes, tag: str) -> tuple[bytes, int, dict[str, str]]:
    """Return one range of a content in memory, or all of it, with the status and the header of the answer."""
    spans = spans_of(headers, len(content), tag)
    if len(spans) != 1:
        return content, 200, {}
    (span,) = spans
    return content[span], 206, {"Content-Range": f"bytes {span.start}-{span.stop - 1}/{len(content)}"}


class Download(FileResponse):
    """A stored file, whole or in ranges, or 304 for a client that has it; sent once the digest is known."""

    compute_digest: Callable[[Path], bytes]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        status = cast("os.stat_result", self.stat_result)
        digests: Digests = scope["app"].state.digests
        try:
            digest = await digests.of_file(Path(self.path), status, self.compute_digest)
        except FileNotFoundError:
            raise _missing(Path(self.path)) from None
        tag, modified, request_headers = tag_of(digest), self.headers["Last-Modified"], Headers(scope=scope)
        if held := check_conditions(request_headers, tag, modified):
            await held(scope, receive, send)
            return
        self.headers.update({"ETag": tag, "Repr-Digest": repr_digest(digest)})
        spans = spans_of(request_headers, status.st_size, tag)
        # The base class gets only ranges that it does not refuse.
        lines = [line for line in scope["headers"] if line[0] not in {b"range", b"if-range"}]
        if spans:
            lines.append((b"range", f"bytes={','.join(f'{span.start}-{span.stop - 1}' for span in spans)}".encode()))
        await super().__call__({**scope, "headers": lines}, receive, send)


def file(
    request: Request,
    path: Path,
    media_type: str,
    *,
    save_as: str | None = None,
    digest: Callable[[Path], bytes] = compute_digest,
) -> Response:
    """Return a stored file as a download.

    Parameters
    ----------
    save_as
        Name under which a browser saves the file; None: from the request's path.
    digest
        Function that computes the file's digest, or refuses the file.
    """
    try:
        status = regular_status(path)
    except FileNotFoundError:
        raise _missing(path) from None
    headers = _saved("inline" if media_type.startswith("image/") else "attachment", save_as or name_of(request))
    download = Download(path, media_type=media_type, stat_result=status, headers=headers)
    download.compute_digest = digest
    return download


def _missing(path: Path) -> Refused:
    return Refused(404, "file-missing", f"{path.name} is not there: it was not written, or was removed")


def name_of(request: Request) -> str:
    """Return the name of a file without a name, from the request's path: `scans-example-sinogram.png`."""
    return request.url.path.removeprefix("/v1/").strip("/").replace("/", "-")
