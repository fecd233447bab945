"""Errors as `application/problem+json` (RFC 9457): a stable code for programs, one sentence for people."""

import reprlib
from collections.abc import Mapping, Sequence
from enum import StrEnum
from http import HTTPStatus
from typing import Any, cast
from urllib.parse import quote

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from structlog.contextvars import get_contextvars

from sawmill_formats.errors import FileError, NotStored, OutOfRange
from sawmill_platform.errors import (
    Busy,
    Conflict,
    Damaged,
    DamagedResult,
    FolderUnavailable,
    Invalid,
    NotFound,
    QueueFull,
    StorageError,
    StorageFull,
    StorageMisconfigured,
    StorageUnavailable,
    UploadTooLarge,
    outage_of,
)
from sawmill_service.http.problem_types import CODE_PATTERN, describe_code, title_of, type_of

MEDIA_TYPE = "application/problem+json"
STATUS: Mapping[type[Exception], int] = {
    NotFound: 404,
    Conflict: 409,
    Busy: 409,
    Invalid: 422,
    Damaged: 400,
    QueueFull: 429,
    UploadTooLarge: 413,
    StorageUnavailable: 503,
    FolderUnavailable: 503,
    StorageMisconfigured: 503,
    StorageFull: 507,
    NotStored: 409,
    DamagedResult: 409,
    OutOfRange: 422,
}
# Pydantic's remark on a default that depends on a refused value.
FOLLOWS_FROM_OTHERS = frozenset({"default_factory_not_called"})
# Type of our own errors, about parts of a query or a body that no model sees; the message is a sentence.
STATED = "stated"
COME_BACK = {"Retry-After": "5"}  # seconds, for every 503 and for busy resources


class ProblemPlace(StrEnum):
    """A part of a request."""

    BODY = "body"
    QUERY = "query"
    PATH = "path"
    HEADER = "header"
    COOKIE = "cookie"


class FieldProblem(BaseModel):
    """A refused value."""

    model_config = ConfigDict(populate_by_name=True)

    location: str = Field(
        description="Place of the value, with the variants that were tried.",
        examples=["body.constants.source_to_cor_mm"],
    )
    message: str = Field(
        description="Fault of the value, and the value.", examples=["should be greater than 0, not -3"]
    )
    in_: ProblemPlace = Field(alias="in", description="Part of the request that has the value.")
    pointer: str | None = Field(
        None,
        json_schema_extra={"format": "json-pointer-uri-fragment"},
        description="JSON pointer to a value of the body (RFC 6901, section 6); `#` is the whole body. Null: the "
        "value is not in the body.",
        examples=["#/constants/source_to_cor_mm"],
    )
    parameter: str | None = Field(
        None,
        description="Name of a parameter of the query, the path or a header. Null: the value is no parameter.",
        examples=["limit"],
    )


class Problem(BaseModel):
    """A problem (RFC 9457)."""

    type: str = Field(
        description="Page of this kind of problem, relative to the address of the request.",
        json_schema_extra={"format": "uri-reference"},
        examples=["/problems/scanner-not-found"],
    )
    title: str = Field(description="Meaning of this kind of problem, in a few words.", examples=["No such scanner"])
    status: int = Field(description="HTTP status of the answer.", examples=[404])
    detail: str = Field(
        description="Sentence with the value, and what would be right.", examples=["there is no scanner 'line-3'"]
    )
    instance: str = Field(description="Path of the request.", examples=["/v1/scanners/line-3"])
    code: str = Field(pattern=CODE_PATTERN, examples=["scanner-not-found"], json_schema_extra=describe_code)
    errors: list[FieldProblem] | None = Field(None, description="Refused values. Null: no value was refused.")
    request_id: str | None = Field(
        None,
        description="The answer's `X-Request-Id`, under which the service's log has more details.",
        examples=["0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )


def problem_response(
    path: str,
    status: int,
    code: str,
    detail: str,
    *,
    errors: Sequence[FieldProblem] | None = None,
    headers: Mapping[str, str] | None = None,
) -> JSONResponse:
    """Shape one problem as a response."""
    problem = Problem(
        type=type_of(code),
        title=title_of(code, status),
        status=status,
        detail=detail,
        instance=path,
        code=code,
        errors=None if errors is None else list(errors),
        request_id=get_contextvars().get("request_id"),
    )
    return JSONResponse(
        problem.model_dump(mode="json", by_alias=True, exclude_none=True),
        status,
        headers=headers,
        media_type=MEDIA_TYPE,
    )


def is_navigation(headers: Headers) -> bool:
    """Return whether a person waits for a page, rather than a program for an answer."""
    return "text/html" in headers.get("accept", "") and "authorization" not in headers


class Refused(HTTPException):
    """A request that a route refuses, with its stable code."""

    def __init__(self, status: int, code: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(status, detail, headers)
        self.code = code


def refusal_response(path: str, refused: Refused) -> JSONResponse:
    """Shape a refusal as a response."""
    return problem_response(path, refused.status_code, refused.code, refused.detail, headers=refused.headers)


def complaint(error: Mapping[str, Any]) -> tuple[str, str]:
    """Turn one of pydantic's errors into a place and a sentence that quotes the value."""
    if error["type"] == "json_invalid":
        return "body", f"is not JSON: {error['ctx']['error']} at character {error['loc'][1]}"
    return ".".join(str(part) for part in error["loc"]), _message(error)


def _field_problem(error: Mapping[str, Any], body: object) -> FieldProblem:
    """Convert one of FastAPI's errors, whose place begins with a part of the request."""
    location, message = complaint(error)
    place, *names = error["loc"]
    if place != ProblemPlace.BODY:
        # A rule about several parameters together names none.
        parameter = str(names[0]) if names else None
        return FieldProblem(location=location, message=message, in_=ProblemPlace(place), parameter=parameter)
    unread = error["type"] == "json_invalid"
    pointer = "#" if unread else _pointer(names, body, adds=error["type"] == "missing")
    return FieldProblem(location=location, message=message, in_=ProblemPlace.BODY, pointer=pointer)


def _pointer(names: Sequence[int | str], body: object, *, adds: bool) -> str:
    """Return a JSON pointer as the fragment of a URI; `adds`: the field of the last name is missing."""
    parts = []
    for number, name in enumerate(names, start=1):
        if _holds(body, name):
            body = body[name]  # type: ignore[index]
        elif not (adds and number == len(names)):
            continue  # a variant of a union, or another name that pydantic adds to the fields
        parts.append(quote(str(name).replace("~", "~0").replace("/", "~1"), safe="~!$&'()*+,;=:@"))
    return "".join(["#", *(f"/{name}" for name in parts)])


def _holds(value: object, name: int | str) -> bool:
    if isinstance(value, list):
        return isinstance(name, int) and name < len(value)
    return isinstance(value, dict) and name in value


def _message(error: Mapping[str, Any]) -> str:
    value, message = error.get("input"), str(error["msg"])
    if tuple(error["loc"]) == ("body",) and isinstance(value, bytes):
        return "must be JSON, with Content-Type: application/json"
    if error["type"] == "missing":
        return "is required"
    if error["type"] in {"extra_forbidden", "unexpected_keyword_argument"}:
        return "is not a known field"
    if error["type"] == STATED:
        return message
    if error["type"] == "value_error":
        refusal = message.removeprefix("Value error, ")
        return refusal if refusal.startswith("must be ") else f"is refused: {refusal}"
    requirement = message.removeprefix("Input ")
    return f"{requirement[0].lower()}{requirement[1:]}, not {reprlib.repr(value)}"


def _on_validation(request: Request, error: Exception) -> JSONResponse:
    refused = cast("RequestValidationError", error)
    problems = [
        _field_problem(item, refused.body) for item in refused.errors() if item["type"] not in FOLLOWS_FROM_OTHERS
    ]
    first, more = problems[0], len(problems) - 1
    detail = f"{first.location} {first.message}" + (f" (and {more} more)" if more else "")
    return problem_response(request.url.path, 422, "invalid-request", detail, errors=problems)


def _on_http(request: Request, error: Exception) -> JSONResponse:
    refused = cast("HTTPException", error)
    path, status = request.url.path, refused.status_code
    if isinstance(refused, Refused):
        return refusal_response(path, refused)
    if status == HTTPStatus.NOT_FOUND:
        code, detail = "unknown-path", f"there is nothing at {path}; /docs lists what there is"
    elif status == HTTPStatus.METHOD_NOT_ALLOWED:
        methods = {*request.app.state.rules.of_path(path)}
        allowed = ", ".join(sorted(methods | ({"HEAD"} if "GET" in methods else set())))
        code, detail = "method-not-allowed", f"{request.method} is not for {path}, which takes {allowed}"
        return problem_response(path, status, code, detail, headers={"Allow": allowed})
    else:
        code, detail = "bad-request", refused.detail  # raised by FastAPI for a body that it cannot parse
    return problem_response(path, status, code, detail, headers=refused.headers)


def _on_stored(request: Request, error: Exception) -> JSONResponse:
    status = STATUS.get(type(error))
    if status is None:
        raise error  # ours, not the client's
    code = cast("StorageError | FileError", error).code
    later = COME_BACK if status == HTTPStatus.SERVICE_UNAVAILABLE or isinstance(error, Busy) else None
    headers = {"Retry-After": str(error.retry_after_s)} if isinstance(error, QueueFull) else later
    return problem_response(request.url.path, status, code, str(error), headers=headers)


def _on_disk(request: Request, error: Exception) -> JSONResponse:
    """Answer an error of the data folder's disk; any other system error is our fault."""
    outage = outage_of(cast("OSError", error), "the request")
    if outage is None:
        raise error
    return _on_stored(request, outage)


def install(app: FastAPI) -> None:
    """Install the handlers of expected errors; the observer answers unexpected ones."""
    app.add_exception_handler(RequestValidationError, _on_validation)
    app.add_exception_handler(HTTPException, _on_http)
    for stored in (StorageError, FileError):
        app.add_exception_handler(stored, _on_stored)
    app.add_exception_handler(OSError, _on_disk)
