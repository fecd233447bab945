"""Refusals of operations in the OpenAPI document: the codes of problems by status."""

from collections.abc import Iterable
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
    Reference.PHANTOM: ("phantom-not-found", "phantom-refused", "phantom-not-named"),
    Reference.CALIBRATION: (
        *("calibration-not-found", "calibration-without-result", "no-active-calibration", "scanner-mismatch"),
    ),
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
        responses[str(status)] = responses.get(str(status), {}) | _refusal(status, codes)


def _by_shape(method: str, rule: Rule, operation: dict[str, Any]) -> Iterable[str]:
    yield from _ALWAYS
    yield from () if isinstance(rule.needs, NoKey) else _WITH_KEY
    yield from () if method == "GET" else _CHANGING
    yield from _DELETING if method == "DELETE" else ()
    yield from _WITH_BODY if "requestBody" in operation else ()
    named = {parameter["name"] for parameter in operation.get("parameters", ())}
    yield from _REPEATABLE if "Idempotency-Key" in named else ()


def _status_of(code: str) -> int:
    status = problem_types()[code].status
    if status is None:
        raise KeyError(f"{code} is a failure of jobs, and no answer's")
    return status


def _by_status(codes: Iterable[str]) -> dict[int, set[str]]:
    by_status: dict[int, set[str]] = {}
    for code in codes:
        by_status.setdefault(_status_of(code), set()).add(code)
    return by_status


def _refusal(status: int, codes: Iterable[str]) -> dict[str, Any]:
    listed = sorted(codes)
    return {
        "description": f"{HTTPStatus(status).phrase}: {', '.join(f'`{code}`' for code in listed)}.",
        CODES_KEY: listed,
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
