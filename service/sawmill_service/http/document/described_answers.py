"""How the OpenAPI document describes what succeeds: files as binary, the headers of every answer, streams of events."""

from collections.abc import Mapping
from typing import Any

from sawmill_service.http.document.refusals import OF_DOWNLOADS, Responses, refuses
from sawmill_service.http.problems import MEDIA_TYPE

BINARY = {"type": "string", "format": "binary"}

_TEXT = {"type": "string"}
HEADERS: dict[str, dict[str, Any]] = {
    "Accept-Ranges": {"description": "`bytes`: parts can be asked for.", "schema": _TEXT},
    "Content-Disposition": {"description": "The name to save the file under.", "schema": _TEXT},
    "Content-Range": {"description": "Which bytes of how many, as in `bytes 0-1023/4096`.", "schema": _TEXT},
    "ETag": {"description": "Stands for these bytes: send it back as `If-None-Match` or `If-Range`.", "schema": _TEXT},
    "Location": {"description": "The path of what was made.", "schema": {"type": "string", "format": "uri-reference"}},
    "Repr-Digest": {"description": "The sha256 of the whole file's bytes, as RFC 9530 writes it.", "schema": _TEXT},
    "Retry-After": {"description": "Seconds until it is worth asking.", "schema": {"type": "integer", "minimum": 0}},
    "Upload-Complete": {"description": "`?1` when all bytes have come, else `?0`.", "schema": _TEXT},
    "Upload-Length": {"description": "Bytes of the whole file.", "schema": {"type": "integer", "minimum": 1}},
    "Upload-Offset": {
        "description": "Bytes that are kept: where the next part begins.",
        "schema": {"type": "integer", "minimum": 0},
    },
    "WWW-Authenticate": {"description": "How a key is brought: Basic and Bearer.", "schema": _TEXT},
    "X-Request-Id": {"description": "Names this request in the service's log.", "schema": _TEXT},
}
for _header in HEADERS.values():
    _header["required"] = True
# By status, where every answer of that status has them.
_BY_STATUS = {
    "202": ("Location", "Retry-After"),
    "206": ("Content-Range",),
    "304": ("ETag",),
    "401": ("WWW-Authenticate",),
    "416": ("Content-Range",),
    "429": ("Retry-After",),
    "503": ("Retry-After",),
}
_OF_FILES = ("Accept-Ranges", "Content-Disposition", "ETag", "Repr-Digest")
_UNCHANGED = "You hold these bytes already, as `If-None-Match` says."

LOCATED: Responses = {201: {"headers": {"Location": {}}}}
"""Of what is made at once: `Location` leads to it."""
NAMED: Responses = {200: {"headers": {"Content-Disposition": {}}}}
"""Of what is written out while it is sent, to be saved as a file."""
SAVED: Responses = {200: {"headers": {"Content-Disposition": {}, "ETag": {}}}, 304: {"description": _UNCHANGED}}
"""Of what is written out for the request, to be saved as a file."""


def offset_answered(status: int = 200, *names: str) -> Responses:
    """Of an upload in parts: the headers of its offset, and others by name."""
    return {status: {"headers": _named("Upload-Complete", "Upload-Length", "Upload-Offset", *names)}}


def with_some(responses: Responses, status: int, *names: str) -> Responses:
    """The same, where only some answers of a status have headers, by name."""
    headers = {name: HEADERS[name] | {"required": False} for name in names}
    return responses | {status: responses[status] | {"headers": headers}}


def drawn(*codes: str, headers: dict[str, Any] | None = None) -> Responses:
    """Of a picture or an array that is made for the request: 304 for a client that holds it.

    Parameters
    ----------
    codes
        The refusals that are the operation's own.
    headers
        Described as OpenAPI has them, beside those of every file.
    """
    whole = {"headers": _named(*_OF_FILES) | (headers or {})}
    return {
        200: whole,
        206: {"description": "The range asked for."} | whole,
        304: {"description": _UNCHANGED},
        **refuses(*OF_DOWNLOADS, *codes),
    }


def stored(*codes: str) -> Responses:
    """As `drawn`, of a stored file, which may have been removed."""
    return drawn("file-missing", "result-damaged", *codes)


def events(description: str, example: str, data: Mapping[str, dict[str, Any]]) -> Responses:
    """Of a stream of events.

    OpenAPI 3.1 has no words for it: a type would be that of the whole text to some readers, of one event to others.

    Parameters
    ----------
    description
        When which event comes.
    example
        The text of a short stream.
    data
        An event's name -> the JSON schema of its data.
    """
    shape = {"schema": {"description": description}, "example": example, "x-event-data": dict(data)}
    return {200: {"description": description, "content": {"text/event-stream": shape}}}


def describe_answers(operation: dict[str, Any]) -> None:
    """Complete an operation's answers: binary bodies, and headers."""
    responses = operation["responses"]
    if "206" in responses:
        responses["206"]["content"] = responses["200"]["content"]
    for status, response in responses.items():
        for media_type, media in response.get("content", {}).items():
            # FastAPI's words for events are those of OpenAPI 3.2, which a 3.1 document may not hold.
            media.pop("itemSchema", None)
            if status < "300" and _is_binary(media_type):
                media["schema"] = BINARY
        own = response.get("headers", {})
        named = {*own, *_BY_STATUS.get(status, ()), "X-Request-Id"}
        response["headers"] = {name: own.get(name) or _reference(name) for name in sorted(named)}


def _named(*headers: str) -> dict[str, Any]:
    """Headers whose description is looked up later."""
    return {name: {} for name in headers}


def _is_binary(media_type: str) -> bool:
    return not media_type.startswith("text/") and media_type not in {"application/json", MEDIA_TYPE}


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/components/headers/{name}"}
