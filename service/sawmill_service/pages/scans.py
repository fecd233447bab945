"""Pages of scans: what was uploaded, what became of it, and what to do with it."""

import re
from functools import partial
from typing import Annotated

from fastapi import Response
from fastapi.responses import RedirectResponse
from pydantic import BeforeValidator, ValidationError

from sawmill_contracts.reconstructions import ReconstructionOptions, ReconstructionRequest
from sawmill_platform.contracts.base import Identifier, placed_complaints
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, Invalid, QueueFull
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import STATUS
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import SCAN_STATES, plain_number
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.lists import TheFilter, phantom_names
from sawmill_service.pages.logs import name_of
from sawmill_store.store import Store
from sawmill_vocabulary import CoordinateMm, ReconstructionMethod

SIZES_PX = (256, 512, 1024, 2048)

router = Router(include_in_schema=False, reading=Scope.READ)


def _two_numbers(text: object) -> object:
    """Split x and y: at spaces or semicolons, beside which a comma is a decimal one, or else at a comma."""
    apart = [part.rstrip(",") for part in re.split(r"[\s;]+", str(text).strip())]
    parts = [plain_number(part) for part in (apart if len(apart) > 1 else apart[0].split(","))]
    if len(parts) != 2:
        raise ValueError(f"must be two numbers, x and y in mm, as in 60, -40, not {text!r:.100}")
    return parts


class LogForm(Given, ReconstructionOptions):
    """Values of the form for a log, as texts."""

    field_centre_mm: Annotated[tuple[CoordinateMm, CoordinateMm], BeforeValidator(_two_numbers)] = (0.0, 0.0)


@router.get("/scans")
def scans(page: ThePage, store: TheStore, settings: TheSettings, chosen: TheFilter) -> Response:
    """Show the list, newest first."""
    return page.answer(
        "scans.html",
        chosen=chosen,
        found=store.scans.page(**chosen.arguments()),
        scanners=store.scanners.names(),
        phantoms=phantom_names(store.phantoms),
        max_bytes=settings.max_upload_bytes,
        states=SCAN_STATES,
    )


@router.get("/scans/{scan_id}")
def scan(scan_id: Identifier, page: ThePage, store: TheStore) -> Response:
    """Show a scan with what can be done with it."""
    return _scan_page(page, store, scan_id)


@router.post("/scans/{scan_id}/reconstruct", needs=Scope.SUBMIT)
def reconstruct(scan_id: Identifier, page: ThePage, store: TheStore, wake: TheWake, fields: TheForm) -> Response:
    """Request a log, and go to its page."""
    texts = {name: value for name, value in fields.items() if name in LogForm.model_fields and value.strip()}
    if "field_mm" in texts:
        texts["field_mm"] = plain_number(texts["field_mm"])
    try:
        log = store.reconstructions.accept(
            ReconstructionRequest(scan_id=scan_id, **LogForm.model_validate(texts).model_dump(exclude_unset=True))
        )
    except ValidationError as error:
        return _scan_page(page, store, scan_id, status=422, problem="; ".join(placed_complaints(error)), typed=fields)
    except (Conflict, Invalid, QueueFull) as error:
        return _scan_page(page, store, scan_id, status=STATUS[type(error)], problem=str(error), typed=fields)
    wake(log.job_id)
    return RedirectResponse(f"/logs/{log.id}", status_code=303)


@router.post("/scans/{scan_id}/delete", needs=Scope.ADMIN)
def delete(scan_id: Identifier, page: ThePage, store: TheStore) -> Response:
    """Delete a scan and return to the list; where a job needs the scan, the page names that job."""
    try:
        store.scans.delete(scan_id)
    except Conflict as error:
        return _scan_page(page, store, scan_id, status=409, problem=str(error))
    return RedirectResponse("/scans", status_code=303)


def _scan_page(
    page: PageFrame,
    store: Store,
    scan_id: str,
    *,
    status: int = 200,
    problem: str = "",
    typed: dict[str, str] | None = None,
) -> Response:
    scan = store.scans.get(scan_id)
    logs = store.reconstructions.page(scan_id=scan_id, limit=10).items
    return page.answer(
        "scan.html",
        status=status,
        scan=scan,
        scanner=store.scanners.get(scan.scanner_id).name,
        phantoms=phantom_names(store.phantoms),
        state=SCAN_STATES[scan.state],
        logs=logs,
        calibrations=store.calibrations.page(scan_id=scan_id, limit=10).items,
        methods=sorted(ReconstructionMethod, key=lambda method: method is not ReconstructionMethod.AUTO),
        sizes=SIZES_PX,
        defaults={name: field.default for name, field in ReconstructionOptions.model_fields.items()},
        problem=problem,
        name_of=partial(name_of, page),
        given=typed or {},
    )
