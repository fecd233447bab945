"""/v1/alarms."""

from typing import Annotated

from fastapi import Query

from sawmill_contracts.alarms import AlarmList
from sawmill_contracts.keys import Scope
from sawmill_platform.contracts.base import Identifier
from sawmill_service.dependencies import TheStore
from sawmill_service.http.route_rules import Router

router = Router(tags=["scanners"], reading=Scope.READ)


@router.get("/v1/alarms", summary="List open alarms")
def list_alarms(
    store: TheStore,
    scanner_id: Annotated[
        Identifier | None,
        Query(description="Those of this scanner. By default those of all.", examples=["example"]),
    ] = None,
) -> AlarmList:
    """What should have come from a scanner by now and has not, and scanners that moved, as their logs together show.

    The limits are `alarms` of the scanner.
    """
    return AlarmList(alarms=store.alarms.open(scanner_id=scanner_id))
