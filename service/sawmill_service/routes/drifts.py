"""/v1/drifts."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from sawmill_service.answers import Paging, accept
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.openapi_document import trying
from sawmill_worker.contracts.base import Identifier, Page
from sawmill_worker.contracts.drifts import Drift, DriftAsk, DriftLinks
from sawmill_worker.contracts.jobs import JobState

router = APIRouter(prefix="/v1/drifts", tags=["drifts"])


class DriftFilter(Paging):
    """Which looks at drift to list."""

    scanner_id: Identifier | None = None
    scan_id: Identifier | None = None
    state: JobState | None = None


@router.post(
    "", status_code=202, summary="Look for drift without a phantom", openapi_extra=trying(body={"scan_id": "example"})
)
def ask_drift(ask: DriftAsk, store: TheStore, settings: TheSettings, wake: TheWake, response: Response) -> Drift:
    """What moved since a calibration, from any scan that goes all round in steps of 3 degrees or less.

    Every ray is measured twice, from either side; where the two agree shows where the centre of rotation falls on the
    detector, and the detector's tilt. The source's distance and the first angle cannot be seen.
    The scan may still be read and the calibration still computed: the job waits for them.
    """
    drift = store.drifts.accept(ask)
    wake(drift.job_id)
    accept(response, f"/v1/drifts/{drift.id}", settings.retry_after_s)
    return _linked(drift)


@router.get("", summary="List looks at drift, newest first")
def list_drifts(query: Annotated[DriftFilter, Query()], store: TheStore) -> Page[Drift]:
    """All of them, or those of one scanner or scan, or in one state."""
    page = store.drifts.page(
        scanner_id=query.scanner_id, scan_id=query.scan_id, state=query.state, after=query.after, limit=query.limit
    )
    return page.model_copy(update={"items": [_linked(item) for item in page.items]})


@router.get("/{drift_id}", summary="Get a look at drift")
def get_drift(drift_id: Identifier, store: TheStore) -> Drift:
    """Its state, and what moved, how surely and where to look once that is known."""
    return _linked(store.drifts.get(drift_id))


def _linked(drift: Drift) -> Drift:
    links = DriftLinks(
        self=f"/v1/drifts/{drift.id}",
        job=f"/v1/jobs/{drift.job_id}",
        calibration=f"/v1/calibrations/{drift.calibration_id}",
    )
    return drift.model_copy(update={"links": links})
