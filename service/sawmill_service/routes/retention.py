"""/v1/retention."""

from typing import Annotated

from fastapi import Query

from sawmill_contracts.retention import Retention, RetentionAsk, RetentionPreview, RetentionQuery, RetentionRules
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheRetention
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.document.refusals import refuses
from sawmill_service.http.route_rules import Router

router = Router(prefix="/v1/retention", tags=["retention"], reading=Scope.READ)


@router.get("", summary="Get the rules of retention")
def get_retention(retention: TheRetention) -> Retention:
    """Return how long each kind is kept, and what has been removed so far. Without rules everything is kept."""
    return retention.get()


@router.get(
    "/preview", needs=Scope.ADMIN, summary="Show what would go by rules", openapi_extra=trying(log_scans_days=14)
)
def preview_retention(tried: Annotated[RetentionQuery, Query()], retention: TheRetention) -> RetentionPreview:
    """List objects that the query's rules, or else the rules in force, would remove within the next hour.

    Nothing is removed. The rules can be put into force with `number` for an hour, although objects age in that time.
    An active calibration, the one before it and their scans are never removed; `stays` lists what else is kept.
    """
    rules = RetentionRules(**tried.model_dump())
    return retention.preview(rules if any(rules.kinds()) else retention.get().rules)


@router.put(
    "",
    needs=Scope.ADMIN,
    summary="Replace the rules of retention",
    openapi_extra=trying(body={"log_scans_days": 14, "reconstructions_days": 30}),
    responses=refuses("retention-unconfirmed"),
)
def replace_retention(ask: Sent[RetentionAsk], retention: TheRetention) -> Retention:
    """Put rules into force from now on, unless they remove more at once than `remove_at_most`.

    Objects beyond the rules are removed at once, in small batches, and others later when they are.
    """
    return retention.replace(ask)
