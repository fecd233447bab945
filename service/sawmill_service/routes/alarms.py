"""/v1/alarms."""

from typing import Annotated

from fastapi import Query

from sawmill_contracts.alarms import AlarmList
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheAlarms
from sawmill_service.http.route_rules import Router

router = Router(tags=["scanners"], reading=Scope.READ)


@router.get("/v1/alarms", summary="List open alarms")
def list_alarms(
    alarms: TheAlarms,
    scanner_id: Annotated[
        Identifier | None,
        Query(description="Id of the scanner whose alarms are listed. Default: all scanners.", examples=["example"]),
    ] = None,
) -> AlarmList:
    """List overdue scans and measurements of scanners, and scanners that moved, as their logs together show.

    The scanner's `alarms` have the limits.
    """
    return AlarmList(alarms=alarms.open(scanner_id=scanner_id))
