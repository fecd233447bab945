"""/v1/alarms, and the notices that people take of alarms and of red scanners."""

from datetime import datetime
from typing import Annotated
from zoneinfo import ZoneInfo

from fastapi import Query
from pydantic import AwareDatetime, Field

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.next_steps import KnownRed
from sawmill_mill.alarms import shift_end
from sawmill_platform.contracts.base import Identifier, Name, Page
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.route_rules import Router
from sawmill_service.scanner_conditions import condition_of
from sawmill_store.store import Store

router = Router(tags=["scanners"], reading=Scope.READ)


@router.get("/v1/alarms", summary="List open alarms")
def list_alarms(
    store: TheStore,
    scanner_id: Annotated[
        Identifier | None,
        Query(description="Id of the scanner whose alarms are listed. Default: all scanners.", examples=["example"]),
    ] = None,
) -> Page[Alarm]:
    """List overdue scans and measurements of scanners, and scanners that moved, as their logs together show.

    The scanner's `alarms` have the limits.
    """
    return Page[Alarm](items=store.alarms.open(scanner_id=scanner_id))


class AcknowledgementRequest(Given):
    """Until when and why a person takes notice of an alarm or of a red scanner."""

    until: AwareDatetime | None = Field(
        None,
        description="End, RFC 3339 with an offset, in the future; of a red scanner within 31 days. Null: the end of "
        "the shift, at 6, 14 or 22 o'clock of the mill's time zone.",
        examples=["2036-03-16T14:00:00+02:00"],
    )
    reason: Name = Field(description="Reason, for the scanner's history and the audit.", examples=["maintenance"])


@router.post(
    "/v1/scanners/{scanner_id}/alarms/{kind}/acknowledge",
    needs=Scope.ACTIVATE,
    summary="Acknowledge an open alarm",
    openapi_extra=trying(kind="no-phantom-scan", body={"until": "2036-03-16T14:00:00+02:00", "reason": "maintenance"}),
    responses=refuses("alarm-not-found", "acknowledgement-ended"),
)
@repeatable
def acknowledge_alarm(
    scanner_id: Identifier, kind: AlarmKind, store: TheStore, acknowledge: Sent[AcknowledgementRequest]
) -> Alarm:
    """Take notice of an alarm until a time: it stays open and is shown, and asks nobody for anything until then."""
    return store.alarms.acknowledge(scanner_id, kind, _end_of(acknowledge, store), acknowledge.reason)


@router.post(
    "/v1/scanners/{scanner_id}/red/acknowledge",
    needs=Scope.ACTIVATE,
    summary="Acknowledge a red scanner",
    openapi_extra=trying(body={"reason": "the bearing is ordered"}),
    responses=refuses("scanner-not-found", "scanner-not-red", "acknowledgement-ended"),
)
@repeatable
def acknowledge_red(scanner_id: Identifier, store: TheStore, acknowledge: Sent[AcknowledgementRequest]) -> KnownRed:
    """Take notice of all that shows a scanner red: it stays red, asks for nothing, and its next step has `known`."""
    red = condition_of(store, store.scanners.get(scanner_id)).red_results
    return store.alarms.acknowledge_red(scanner_id, red, _end_of(acknowledge, store), acknowledge.reason)


def _end_of(acknowledge: AcknowledgementRequest, store: Store) -> datetime:
    """Return the end that a person gave, or the end of the shift."""
    return acknowledge.until or shift_end(datetime.now(ZoneInfo(store.mill_zone.get() or "UTC")))
