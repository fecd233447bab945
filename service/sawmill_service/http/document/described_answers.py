"""Answers in the OpenAPI document: binary files, headers, streams of events, and refusals by codes of problems."""

from collections.abc import Iterable, Mapping
from http import HTTPStatus
from typing import Any

from sawmill_contracts.kinds import AskedKind, Reference
from sawmill_service.http.problem_types import problem_types
from sawmill_service.http.problems import MEDIA_TYPE
from sawmill_service.http.route_rules import NoKey, Rule

Responses = dict[int | str, dict[str, Any]]

CODES_KEY = "x-problem-codes"
_ALWAYS = (
    *("bad-length", "unknown-host", "invalid-request", "too-many-requests", "too-many-headers", "internal"),
    *("storage-unavailable", "storage-full", "head-too-large", "body-too-large"),
)
_WITH_KEY = ("token-required", "scope-too-small")
_CHANGING = ("other-site", "csrf")
_WITH_BODY = ("bad-digest", "bad-request", "digest-mismatch", "slow-body", "stopping")
_DELETING = ("bad-digest", "digest-mismatch", "slow-body", "stopping")
_REPEATABLE = ("bad-digest", "bad-idempotency-key", "digest-mismatch", "idempotency-key-reused")
OF_DOWNLOADS = ("bad-range", "precondition-failed", "range-beyond-end")
_OF_UPLOADS = (
    *("bad-encoding", "empty-body", "packed-too-well", "unsupported-encoding", "unsupported-media-type"),
    "upload-too-large",
)
OF_UPLOAD_ID = ("upload-not-found", "upload-incomplete", "upload-lost", "upload-used", "two-files")
OF_QUEUE = ("queue-full",)
OF_SCAN = ("scan-not-found", "scan-ingesting", "scan-refused", "result-damaged")
OF_RESULT = ("reconstruction-not-found", "reconstruction-without-result", "result-damaged")
_OF_REFERENCES = {
    Reference.SCAN: ("scan-not-found", "scan-refused"),
    Reference.SCANNER: ("scanner-not-found",),
    Reference.INSPECTION: ("inspection-not-found", "inspection-expired"),
    Reference.PHANTOM: ("phantom-not-found", "phantom-refused", "phantom-not-named"),
    Reference.CALIBRATION: (
        *("calibration-not-found", "calibration-without-result", "no-active-calibration", "scanner-mismatch"),
    ),
    Reference.FIXED_PAIRS: ("fixed-pairs-not-found", "fixed-pairs-without-result"),
    Reference.THETA: ("no-active-calibration",),
}


def refuses(*codes: str) -> Responses:
    """Describe the specific refusals of an operation, for `responses` in the decorator; common ones are added later."""
    return {status: {CODES_KEY: sorted(listed)} for status, listed in _by_status(codes).items()}


def refuses_upload(*codes: str) -> Responses:
    """Describe the refusals of an operation whose body is a file."""
    return refuses(*_OF_UPLOADS, *codes)


def refuses_ask(declared: AskedKind[Any, Any]) -> Responses:
    """Describe the refusals of asking for a kind of job, by the resources that it refers to."""
    codes = {code for reference in declared.references for code in _OF_REFERENCES[reference]}
    fields = declared.options.model_fields
    codes |= {code for name, code in (("rows", "rows-outside"), ("views", "views-too-many")) if name in fields}
    return refuses(*codes, *OF_QUEUE)


def list_refusals(method: str, rule: Rule, operation: dict[str, Any]) -> None:
    """List the refusals of an operation in the document: specific ones, and those that follow from its shape."""
    responses = operation["responses"]
    own = {code for response in responses.values() for code in response.pop(CODES_KEY, ())}
    for status, codes in sorted(_by_status({*own, *_by_shape(method, rule, operation)}).items()):
        listed = sorted(codes)
        responses[str(status)] = responses.get(str(status), {}) | {
            "description": f"{HTTPStatus(status).phrase}: {', '.join(f'`{code}`' for code in listed)}.",
            CODES_KEY: listed,
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }


def _by_shape(method: str, rule: Rule, operation: dict[str, Any]) -> Iterable[str]:
    yield from _ALWAYS
    yield from () if isinstance(rule.needs, NoKey) else _WITH_KEY
    yield from () if method == "GET" else _CHANGING
    yield from _DELETING if method == "DELETE" else ()
    yield from _WITH_BODY if "requestBody" in operation else ()
    named = {parameter["name"] for parameter in operation.get("parameters", ())}
    yield from _REPEATABLE if "Idempotency-Key" in named else ()


def _by_status(codes: Iterable[str]) -> dict[int, set[str]]:
    by_status: dict[int, set[str]] = {}
    for code in codes:
        status = problem_types()[code].status
        if status is None:
            raise KeyError(f"{code} is a failure of jobs, and no answer's")
        by_status.setdefault(status, set()).add(code)
    return by_status


BINARY = {"type": "string", "format": "binary"}

_TEXT = {"type": "string"}
HEADERS: dict[str, dict[str, Any]] = {
    "Accept-Ranges": {"description": "`bytes`: parts can be requested.", "schema": _TEXT},
    "Content-Disposition": {"description": "Name under which to save the file.", "schema": _TEXT},
    "Content-Range": {"description": "Range of bytes and their total, as in `bytes 0-1023/4096`.", "schema": _TEXT},
    "ETag": {"description": "Tag of these bytes: send it back as `If-None-Match` or `If-Range`.", "schema": _TEXT},
    "Location": {
        "description": "Path of the created resource.",
        "schema": {"type": "string", "format": "uri-reference"},
    },
    "Repr-Digest": {"description": "SHA-256 of the whole file's bytes, in the form of RFC 9530.", "schema": _TEXT},
    "Retry-After": {
        "description": "Seconds after which to request again.",
        "schema": {"type": "integer", "minimum": 0},
    },
    "Upload-Complete": {"description": "`?1` when all bytes have arrived, else `?0`.", "schema": _TEXT},
    "Upload-Length": {"description": "Number of bytes of the whole file.", "schema": {"type": "integer", "minimum": 1}},
    "Upload-Offset": {
        "description": "Number of bytes that are stored: the next part starts there.",
        "schema": {"type": "integer", "minimum": 0},
    },
    "WWW-Authenticate": {"description": "Authentication schemes for a key: Basic and Bearer.", "schema": _TEXT},
    "X-Request-Id": {"description": "Id of this request in the service's log.", "schema": _TEXT},
}
for _header in HEADERS.values():
    _header["required"] = True
# Headers that every answer of a status has.
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
# FastAPI's words for every answer that a route does not describe.
_GENERATED = "Successful Response"
_UNCHANGED = "The client already holds these bytes, as `If-None-Match` states."

# Answer of a route that creates a resource at once: `Location` leads to the resource.
LOCATED: Responses = {201: {"headers": {"Location": {}}}}
# Answer that is written while it is sent, to be saved as a file.
NAMED: Responses = {200: {"headers": {"Content-Disposition": {}}}}
# Answer that is written for the request, to be saved as a file.
SAVED: Responses = {200: {"headers": {"Content-Disposition": {}, "ETag": {}}}, 304: {"description": _UNCHANGED}}


def offset_answered(status: int = 200, *names: str) -> Responses:
    """Describe the answer of an upload in parts, with the headers of the offset, and more headers by name."""
    return {status: {"headers": _named("Upload-Complete", "Upload-Length", "Upload-Offset", *names)}}


def with_some(responses: Responses, status: int, *names: str) -> Responses:
    """Add headers by name, which only some answers of a status have."""
    headers = {name: HEADERS[name] | {"required": False} for name in names}
    return responses | {status: responses[status] | {"headers": headers}}


def drawn(*codes: str, headers: dict[str, Any] | None = None) -> Responses:
    """Describe a picture or an array that is made for the request, with 304 for a client that has it already.

    Parameters
    ----------
    codes
        Refusals that are specific to the operation.
    headers
        Headers with their OpenAPI descriptions, in addition to the headers of every file.
    """
    whole = {"headers": _named(*_OF_FILES) | (headers or {})}
    return {
        200: whole,
        206: {"description": "The requested range."} | whole,
        304: {"description": _UNCHANGED},
        **refuses(*OF_DOWNLOADS, *codes),
    }


def stored(*codes: str) -> Responses:
    """Describe a stored file, which may have been removed; otherwise as `drawn`."""
    return drawn("file-missing", "result-damaged", *codes)


def events(description: str, example: str, data: Mapping[str, dict[str, Any]]) -> Responses:
    """Describe a stream of events.

    OpenAPI 3.1 has no terms for a stream: some readers take a schema for the whole text, other readers for one event.

    Parameters
    ----------
    description
        Events, and when each is sent.
    example
        Text of a short stream.
    data
        JSON schema of the data of each event, by the event's name.
    """
    shape = {"schema": {"description": description}, "example": example, "x-event-data": dict(data)}
    return {200: {"description": description, "content": {"text/event-stream": shape}}}


def describe_answers(operation: dict[str, Any]) -> None:
    """Complete an operation's answers: what they are, binary bodies, and headers."""
    responses = operation["responses"]
    for status, response in responses.items():
        if response["description"] == _GENERATED:
            response["description"] = HTTPStatus(int(status)).phrase
    if "206" in responses:
        responses["206"]["content"] = responses["200"]["content"]
    for status, response in responses.items():
        for media_type, media in response.get("content", {}).items():
            # FastAPI describes events by a keyword of OpenAPI 3.2, which a 3.1 document may not have.
            media.pop("itemSchema", None)
            if status < "300" and (
                not media_type.startswith("text/") and media_type not in {"application/json", MEDIA_TYPE}
            ):
                media["schema"] = BINARY
        own = response.get("headers", {})
        named = {*own, *_BY_STATUS.get(status, ()), "X-Request-Id"}
        response["headers"] = {
            name: own.get(name) or {"$ref": f"#/components/headers/{name}"} for name in sorted(named)
        }


def _named(*headers: str) -> dict[str, Any]:
    """Return headers whose descriptions are added later."""
    return {name: {} for name in headers}
