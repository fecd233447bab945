"""Whether an answer is one that the OpenAPI document lists for its operation."""

import json
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
from sqlalchemy import select
from starlette.routing import compile_path

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_store.activations import active_calibration_id
from sawmill_store.mill_tables import AlarmRow, DriftRow
from sawmill_store.store import Store

# Of requests that no operation describes: another method, or a path that has another one's form by accident.
_UNKNOWN = {"unknown-path", "method-not-allowed"}


@cache
def committed() -> dict[str, Any]:
    """The document as it is committed, which a test compares with the service's own: making it anew takes a second."""
    document: dict[str, Any] = json.loads((Path(__file__).parents[2] / "openapi/openapi.json").read_text())
    return document


def check_documented(answer: httpx.Response) -> None:
    """Fail for a status, a code of a problem, a media type or a missing header that is not documented."""
    document = committed()
    operation = _operation(document, answer.request.method.lower(), answer.request.url.path)
    if operation is None or answer.status_code == HTTPStatus.SEE_OTHER:
        return
    asked = f"{answer.request.method} {answer.request.url.path}"
    media_type = answer.headers.get("content-type", "").partition(";")[0]
    code = answer.json().get("code") if media_type == "application/problem+json" else None
    if code in _UNKNOWN:
        return
    listed = operation["responses"].get(str(answer.status_code))
    assert listed is not None, f"{asked}: {answer.status_code} {code} is not listed"
    response = _resolved(document, listed)
    if code is not None:
        assert code in response["x-problem-codes"], f"{asked}: {answer.status_code} {code} is not listed: `refuses`"
    if answer.content:
        known = {*response.get("content", {}), *(["text/html"] if code is None else [])}
        assert media_type in known, f"{asked}: {media_type} is not listed among {sorted(known)}"
    for name, header in response["headers"].items():
        if _resolved(document, header).get("required"):
            assert name in answer.headers, f"{asked}: {answer.status_code} comes without {name}"


def _operation(document: dict[str, Any], method: str, path: str) -> dict[str, Any] | None:
    """That of the path without parameters, where there are two."""
    for pattern in [path, *document["paths"]]:
        item = document["paths"].get(pattern, {})
        if method in item and compile_path(pattern)[0].match(path):
            found: dict[str, Any] = item[method]
            return found
    return None


def _resolved(document: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    for name in part.get("$ref", "").split("/")[1:]:
        document = document[name]
    return document if "$ref" in part else part


def add_what_is_decided(store: Store) -> None:
    """Add an open alarm, a red scanner and a cancelled calibration: a fresh data folder has nothing to decide about."""
    calibration = store.calibrations.accept(CalibrationRequest(scan_id="example"), identifier="example-spare")
    store.jobs.request_cancel(calibration.job_id)
    with store.database.write() as session:
        check = session.scalars(select(DriftRow).where(DriftRow.result.is_not(None))).first()
        check.result = check.result | {"within_tolerance": False}
        check.calibration_id, check.created_at = active_calibration_id(session, "example"), store.now()
        session.add(AlarmRow(scanner_id="example", kind=AlarmKind.NO_PHANTOM_SCAN, since=store.now()))


def with_file(example: dict[str, Any], content: bytes) -> dict[str, Any]:
    """What httpx is given for an example whose body is a file of this content."""
    return {"content": content, "headers": example["headers"] | {"Content-Type": example["media_type"]}}
