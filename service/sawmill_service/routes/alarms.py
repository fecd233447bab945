"""/v1/alarms."""

from typing import Annotated

from fastapi import Query
from pydantic import AwareDatetime, Field

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_platform.contracts.base import Identifier, Name, Page
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheAlarms
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.route_rules import Router

router = Router(tags=["scanners"], reading=Scope.READ)


@router.get("/v1/alarms", summary="List open alarms")
def list_alarms(
    alarms: TheAlarms,
    scanner_id: Annotated[
        Identifier | None,
        Query(description="Id of the scanner whose alarms are listed. Default: all scanners.", examples=["example"]),
    ] = None,
) -> Page[Alarm]:
    """List overdue scans and measurements of scanners, and scanners that moved, as their logs together show.

    The scanner's `alarms` have the limits.
    """
    return Page[Alarm](items=alarms.open(scanner_id=scanner_id))


class AcknowledgementRequest(Given):
    """Until when and why a person takes notice of an alarm."""

    until: AwareDatetime = Field(
        description="End, RFC 3339 with an offset, in the future.", examples=["2036-03-16T14:00:00+02:00"]
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
    scanner_id: Identifier, kind: AlarmKind, alarms: TheAlarms, acknowledge: Sent[AcknowledgementRequest]
) -> Alarm:
    """Take notice of an alarm until a time: it stays open and is shown, and asks nobody for anything until then."""
    return alarms.acknowledge(scanner_id, kind, acknowledge.until, acknowledge.reason)
