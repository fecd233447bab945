"""The pages for people: the API console, its assets and example file, the operator's page."""

from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, RedirectResponse

from sawmill_service.answers import file
from sawmill_service.dependencies import TheStore
from sawmill_service.operator_page import ScannerCondition, operator_page
from sawmill_worker.contracts.base import Identifier
from sawmill_worker.contracts.calibrations import CalibrationSucceeded, CalibrationUnfinished
from sawmill_worker.contracts.jobs import JobState
from sawmill_worker.contracts.scanners import StoredScanner
from sawmill_worker.storage.store import Store

STATIC = Path(__file__).parent.parent / "static"
SHOWN_SCANNERS = 200  # more than any mill has

router = APIRouter(include_in_schema=False)


@router.get("/docs")
def console() -> Response:
    """The API console: Swagger UI from this service's own files."""
    return FileResponse(STATIC / "console.html")


@router.get("/openapi.json")
def openapi(request: Request) -> Response:
    """The OpenAPI document."""
    document: bytes = request.app.openapi_json
    return Response(document, media_type="application/json")


@router.get("/examples/phantom-scan.npz")
def example_scan(request: Request, store: TheStore) -> Response:
    """A small scan to upload."""
    path = store.files.folder / "examples" / "phantom-scan.npz"
    return file(request, path, "application/octet-stream", save_as=path.name)


@router.get("/")
def operator(store: TheStore) -> HTMLResponse:
    """The operator's page."""
    scanners = store.scanners.page(limit=SHOWN_SCANNERS).items
    return HTMLResponse(operator_page([_condition(store, scanner) for scanner in scanners]))


@router.post("/operator/activate/{calibration_id}")
def accept_or_roll_back(calibration_id: Identifier, store: TheStore) -> RedirectResponse:
    """The operator's buttons."""
    store.calibrations.activate(calibration_id, "by hand on the operator's page")
    return RedirectResponse("/", status_code=303)


def _condition(store: Store, scanner: StoredScanner) -> ScannerCondition:
    ended = [
        calibration
        for state in (JobState.SUCCEEDED, JobState.FAILED)
        for calibration in store.calibrations.page(scanner_id=scanner.id, state=state, limit=1).items
    ]
    looks = [
        look
        for state in (JobState.SUCCEEDED, JobState.FAILED)
        for look in store.drifts.page(scanner_id=scanner.id, state=state, limit=1).items
    ]
    last = max(ended, key=lambda calibration: calibration.created_at, default=None)
    return ScannerCondition(
        scanner=scanner,
        newest=next((item for item in ended if isinstance(item, CalibrationSucceeded)), None),
        failure=last.failure if isinstance(last, CalibrationUnfinished) else None,
        drift=max(looks, key=lambda look: look.created_at, default=None),
        history=store.scanners.history(scanner.id, limit=20),
    )
