"""/v1/schedules."""

from typing import Annotated

from fastapi import Query, Response

from sawmill_contracts.schedules import Schedule, ScheduleRequest, ScheduleRun
from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import LOCATED, refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import Paging
from sawmill_service.http.responses.conditional import REPLACED, TAGGED, ThePrecondition, tagged
from sawmill_service.http.route_rules import Router

router = Router(prefix="/v1/schedules", tags=["schedules"], reading=Scope.READ)

EXAMPLE = {"scanner_id": "example", "cron": "30 5 * * 1-6", "time_zone": "Europe/Helsinki", "enabled": False}


@router.post(
    "",
    needs=Scope.ACTIVATE,
    status_code=201,
    summary="Schedule a scanner's recalibration or drift checks",
    openapi_extra=trying(body=EXAMPLE),
    responses=LOCATED | refuses("scanner-not-found", "invalid-cron", "invalid-zone", "turned-between-passages"),
)
@repeatable
def create_schedule(spec: Sent[ScheduleRequest], store: TheStore, response: Response) -> Schedule:
    """Calibrate, at each due time, the newest phantom scan that no schedule has used, or check for drift.

    A drift check takes the newest log scan of 8 views or more that has no drift check yet.
    """
    schedule = store.schedules.create(spec)
    response.headers["Location"] = f"/v1/schedules/{schedule.id}"
    return schedule


@router.get("", summary="List schedules, newest first", responses=refuses("invalid-cursor"))
def list_schedules(paging: Annotated[Paging, Query()], store: TheStore) -> Page[Schedule]:
    """List schedules, each with its next due time and its last run."""
    return store.schedules.page(after=paging.after, limit=paging.limit)


@router.get("/{schedule_id}", summary="Get a schedule", responses=TAGGED | refuses("schedule-not-found"))
def get_schedule(schedule_id: Identifier, store: TheStore, response: Response) -> Schedule:
    """Return the schedule, its next due time, and its last outcome."""
    return tagged(response, store.schedules.get(schedule_id))


@router.put(
    "/{schedule_id}",
    needs=Scope.ACTIVATE,
    summary="Replace a schedule",
    openapi_extra=trying(body=EXAMPLE),
    responses=REPLACED
    | refuses("schedule-not-found", "scanner-not-found", "invalid-cron", "invalid-zone", "turned-between-passages"),
)
def replace_schedule(
    schedule_id: Identifier,
    spec: Sent[ScheduleRequest],
    store: TheStore,
    precondition: ThePrecondition,
    response: Response,
) -> Schedule:
    """Replace a schedule. Due times are counted from now, unless one is overdue and `cron` and `time_zone` stay."""
    return tagged(response, store.schedules.update(schedule_id, spec, check=precondition))


@router.delete(
    "/{schedule_id}",
    needs=Scope.ACTIVATE,
    status_code=204,
    summary="Delete a schedule",
    openapi_extra=trying(schedule_id="example-spare"),
    responses=refuses("schedule-not-found"),
)
def delete_schedule(schedule_id: Identifier, store: TheStore) -> None:
    """Delete a schedule; calibrations that it requested stay."""
    store.schedules.delete(schedule_id)


@router.get("/{schedule_id}/runs", summary="List a schedule's outcomes", responses=refuses("schedule-not-found"))
def list_schedule_runs(schedule_id: Identifier, store: TheStore) -> list[ScheduleRun]:
    """List one entry for each due time, newest first."""
    return store.schedules.runs(schedule_id)
