"""API console with its document and example file, and the buttons that decide about calibrations and alarms."""

from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from fastapi import Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from fastapi.staticfiles import StaticFiles
from starlette.types import Receive, Send
from starlette.types import Scope as RequestScope

from sawmill_contracts.alarms import AlarmKind
from sawmill_mill.alarms import shift_end
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.files.file_store import EXAMPLES
from sawmill_service.dependencies import TheCaller, TheStore
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import file, of_type
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.page_frame import ThePage, local_path
from sawmill_service.pages.frame.stored_words import BY_HAND
from sawmill_service.pages.lists import check_zone
from sawmill_service.scanner_conditions import condition_of

STATIC = Path(__file__).parent.parent / "static"

LONGEST_REASON = 200
JsonText = of_type("application/json")


class WholeFiles(StaticFiles):
    """Files of the pages, each sent whole: Starlette would refuse a malformed range in plain text.

    The answers do not offer ranges either (`Accept-Ranges`).
    """

    async def __call__(self, scope: RequestScope, receive: Receive, send: Send) -> None:
        """Answer one request; a server may ignore a range (RFC 9110, section 14.2)."""
        headers = [(name, value) for name, value in scope["headers"] if name != b"range"]
        await super().__call__({**scope, "headers": headers}, receive, send)

    def file_response(self, *args: Any, **options: Any) -> Response:  # noqa: ANN401 - as Starlette gives them
        """Return a file, or 304."""
        answer = super().file_response(*args, **options)
        del answer.headers["Accept-Ranges"]
        return answer


router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/docs")
def console(page: ThePage) -> HTMLResponse:
    """Show the API console: Swagger UI from this service's own files."""
    return page.answer("console.html")


@router.get("/openapi.json")
def openapi(request: Request) -> Response:
    """Return the OpenAPI document."""
    return picture(request, "the document", lambda: request.app.openapi_json, answer=JsonText)


@router.get("/examples/phantom-scan.npz")
def example_scan(request: Request, store: TheStore) -> Response:
    """Return a small scan to upload."""
    path = store.files.folder / EXAMPLES / "phantom-scan.npz"
    return file(request, path, "application/octet-stream", save_as=path.name)


@router.post("/operator/activate/{calibration_id}", needs=Scope.ACTIVATE)
def accept_or_roll_back(calibration_id: Identifier, store: TheStore, typed: TheForm) -> RedirectResponse:
    """Activate a calibration, for the buttons that accept and roll back; the field `next` leads back to their page."""
    store.calibrations.activate(calibration_id, _reason(typed))
    return _back(typed)


@router.post("/operator/discard/{calibration_id}", needs=Scope.ACTIVATE)
def discard(calibration_id: Identifier, store: TheStore, typed: TheForm) -> RedirectResponse:
    """Discard a calibration, for the button of pages."""
    store.calibrations.discard(calibration_id, _reason(typed))
    return _back(typed)


@router.post("/operator/acknowledge/{scanner_id}", needs=Scope.ACTIVATE)
def acknowledge_red(scanner_id: Identifier, store: TheStore, typed: TheForm) -> RedirectResponse:
    """Take notice of what shows a scanner red, until a time of the reader's clock or the end of the shift."""
    results = condition_of(store, store.scanners.get(scanner_id)).red_results
    store.alarms.acknowledge_red(scanner_id, results, _until(typed), _reason(typed))
    return _back(typed)


@router.post("/operator/acknowledge/{scanner_id}/{kind}", needs=Scope.ACTIVATE)
def acknowledge(scanner_id: Identifier, kind: AlarmKind, store: TheStore, typed: TheForm) -> RedirectResponse:
    """Acknowledge an alarm until a time of the reader's clock, or until the end of the shift where none is given."""
    store.alarms.acknowledge(scanner_id, kind, _until(typed), _reason(typed))
    return _back(typed)


@router.post("/operator/time-zone", needs=Scope.ACTIVATE)
def set_time_zone(store: TheStore, caller: TheCaller, typed: TheForm) -> RedirectResponse:
    """Set the time zone of the mill: the first one by a browser, another one by an administrator."""
    first, time_zone = bool(typed.get("first")), check_zone(typed.get("time_zone", "").strip()[:64])
    if not first:
        caller.check(Scope.ADMIN)
    if time_zone:
        store.mill_zone.set(time_zone, first=first)
    return _back(typed)


def _until(typed: dict[str, str]) -> datetime:
    zone, text = check_zone(typed.get("zone", "")), typed.get("until", "")
    now = datetime.now(ZoneInfo(zone)) if zone else datetime.now().astimezone()
    if not text:
        return shift_end(now)
    try:
        return datetime.fromisoformat(text).replace(tzinfo=now.tzinfo)
    except ValueError as error:
        raise Refused(422, "invalid-request", f"until must be a time such as 2026-03-16T14:00, not {text!r}") from error


def _reason(typed: dict[str, str]) -> str:
    """Return the reason that was chosen, else the one that was typed."""
    text = typed.get("chosen") or typed.get("reason", "")
    return "".join(letter for letter in text if letter.isprintable()).strip()[:LONGEST_REASON] or BY_HAND


def _back(typed: dict[str, str]) -> RedirectResponse:
    """Lead back to the page of the button."""
    return RedirectResponse(local_path(typed.get("next", "/")), status_code=303)
