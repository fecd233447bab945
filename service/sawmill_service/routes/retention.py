"""/v1/retention."""

from typing import Annotated

from fastapi import Query

from sawmill_contracts.keys import Scope
from sawmill_contracts.retention import (
    Retention,
    RetentionAsk,
    RetentionPreview,
    RetentionQuery,
    RetentionRules,
)
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.document.refusals import refuses
from sawmill_service.http.route_rules import Router

router = Router(prefix="/v1/retention", tags=["retention"], reading=Scope.READ)


@router.get("", summary="Get the rules of retention")
def get_retention(store: TheStore) -> Retention:
    """How long what is kept, and what has gone by it so far. Without rules everything stays."""
    return store.retention.get()


@router.get(
    "/preview", needs=Scope.ADMIN, summary="Show what would go by rules", openapi_extra=trying(log_scans_days=14)
)
def preview_retention(tried: Annotated[RetentionQuery, Query()], store: TheStore) -> RetentionPreview:
    """What would go within the next hour by the rules of the query, or by those in force where it names none.

    Nothing goes. The rules may be put into force with `number` for an hour, although things become too old in it.
    An active calibration, the one before it and what they were made of never go; `stays` tells what else stays.
    """
    rules = RetentionRules(**tried.model_dump())
    return store.retention.preview(rules if any(rules.kinds()) else store.retention.get().rules)


@router.put(
    "",
    needs=Scope.ADMIN,
    summary="Replace the rules of retention",
    openapi_extra=trying(body={"log_scans_days": 14, "reconstructions_days": 30}),
    responses=refuses("retention-unconfirmed"),
)
def replace_retention(ask: Sent[RetentionAsk], store: TheStore) -> Retention:
    """They hold from now on, unless they remove more at once than `remove_at_most`.

    What they reach goes at once, a few at a time, and later as it becomes too old or too much.
    """
    return store.retention.replace(ask)
