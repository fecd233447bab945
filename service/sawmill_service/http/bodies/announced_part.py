"""Headers of a PATCH that describe a part of an upload, by the draft "Resumable Uploads for HTTP"."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.datastructures import Headers

from sawmill_platform.contracts.uploads import Upload
from sawmill_service.http.bodies.body_sums import boolean_in, integer_in
from sawmill_service.http.problems import Refused

Value = TypeVar("Value")

_MOST = 10**15 - 1  # largest integer in a structured field
_BYTES = {"type": "integer", "minimum": 0, "maximum": _MOST}


def _header(name: str, description: str, schema: dict[str, Any], *, required: bool = False) -> dict[str, Any]:
    return {"name": name, "in": "header", "description": description, "required": required, "schema": schema}


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
"""Headers as the OpenAPI document describes them. A wrong one is answered with 400, unlike a field of a form."""


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
    offset_bytes = _read(headers, "Upload-Offset", _count_in, "a count of bytes, as in 1048576")
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
        size_bytes=_read(headers, "Upload-Length", _count_in, "a count of bytes, as in 1048576"),
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


def _count_in(text: str) -> int | None:
    number = integer_in(text)
    return number if number is not None and number >= 0 else None
