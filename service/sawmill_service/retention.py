"""`/v1/retention`, and the page `/retention`, which asks for each confirmation with the number of objects."""

import re
from typing import Annotated, NamedTuple

from fastapi import Query, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from pydantic import ValidationError

from sawmill_contracts.retention import (
    LONGEST_DAYS,
    Retention,
    RetentionKind,
    RetentionPreview,
    RetentionQuery,
    RetentionRequest,
    RetentionRules,
)
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.responses.conditional import REPLACED, TAGGED, ThePrecondition, tagged
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import marked, plain_number
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_store.retention.retention_store import RetentionStore

KINDS = {
    RetentionKind.LOG_SCANS: marked("Scans of logs"),
    RetentionKind.PHANTOM_SCANS: marked("Scans of phantoms"),
    RetentionKind.RECONSTRUCTIONS: marked("Reconstructions"),
    RetentionKind.CALIBRATIONS: marked("Calibrations that were never active"),
    RetentionKind.DRIFTS: marked("Drift checks"),
    RetentionKind.INSPECTIONS: marked("Inspected files"),
    RetentionKind.EVENTS: marked("Events"),
}
PAGE = "/retention"

router = Router(prefix="/v1/retention", tags=["retention"], reading=Scope.READ)
pages = Router(include_in_schema=False, reading=Scope.ADMIN)


@router.get("", summary="Get the rules of retention", responses=TAGGED)
def get_retention(store: TheStore, response: Response) -> Retention:
    """Return how long each kind is kept, and what has been removed so far. Without rules everything is kept."""
    return tagged(response, store.retention.get())


@router.get(
    "/preview", needs=Scope.ADMIN, summary="Show what would go by rules", openapi_extra=trying(log_scans_days=14)
)
def preview_retention(tried: Annotated[RetentionQuery, Query()], store: TheStore) -> RetentionPreview:
    """Count objects that the query's rules, or else the rules in force, would remove within the next hour.

    Nothing is removed. The rules can be put into force with `number` for an hour, although objects age in that time.
    An active calibration, the one before it and their scans are never removed; `stays` counts what is kept.
    """
    rules = RetentionRules(**tried.model_dump())
    return store.retention.preview(rules if rules.days() else store.retention.get().rules)


@router.put(
    "",
    needs=Scope.ADMIN,
    summary="Replace the rules of retention",
    openapi_extra=trying(body={"log_scans_days": 14, "reconstructions_days": 30}),
    responses=REPLACED | refuses("retention-unconfirmed"),
)
def replace_retention(
    ask: Sent[RetentionRequest], store: TheStore, precondition: ThePrecondition, response: Response
) -> Retention:
    """Put rules into force from now on, unless they remove more at once than `remove_at_most`.

    Objects beyond the rules are removed at once, in small batches, and others later when they are.
    """
    return tagged(response, store.retention.replace(ask, check=precondition))


class Typed(NamedTuple):
    """Days as a person typed them, and the wrong ones of them, by the names of the rules."""

    values: dict[str, str]
    wrong: set[str]

    def rules(self) -> RetentionRules:
        """Return the typed rules, which nobody may use where one is wrong."""
        return RetentionRules.model_validate(
            {name: int(plain_number(days)) for name, days in self.values.items() if days}
        )


@pages.get(PAGE)
def show(page: ThePage, store: TheStore) -> HTMLResponse:
    """Show the rules in force, and the form for new ones."""
    return _answer(page, store.retention)


@pages.post(PAGE, needs=Scope.ADMIN)
def try_rules(page: ThePage, store: TheStore, sent: TheForm) -> HTMLResponse:
    """Show what typed rules would remove, or the form again with what is wrong; nothing is removed."""
    typed = _typed(sent)
    if typed.wrong:
        return _answer(page, store.retention, status=422, typed=typed)
    return _answer(page, store.retention, typed=typed, preview=store.retention.preview(typed.rules()))


@pages.post(f"{PAGE}/confirmed", needs=Scope.ADMIN, response_model=None)
def confirm(page: ThePage, store: TheStore, sent: TheForm) -> HTMLResponse | RedirectResponse:
    """Put the rules into force, or show the new number if they would now remove more than was confirmed."""
    typed = _typed(sent)
    if typed.wrong:
        return _answer(page, store.retention, status=422, typed=typed)
    rules = typed.rules()
    try:
        confirmed = {"remove_at_most": sent.get("remove_at_most", 0)}
        store.retention.replace(RetentionRequest.model_validate(rules.model_dump() | confirmed))
    except (Conflict, ValidationError):
        return _answer(
            page, store.retention, status=409, typed=typed, preview=store.retention.preview(rules), changed=True
        )
    return RedirectResponse(PAGE, status_code=303)


def _typed(sent: TheForm) -> Typed:
    values = {name: sent.get(name, "").strip() for name in RetentionRules.model_fields}
    return Typed(values, {name for name, days in values.items() if days and not _is_days(plain_number(days))})


def _is_days(plain: str) -> bool:
    return re.fullmatch(r"[0-9]{1,6}", plain) is not None and 1 <= int(plain) <= LONGEST_DAYS


def _answer(
    page: PageFrame,
    retention: RetentionStore,
    *,
    status: int = 200,
    typed: Typed | None = None,
    preview: RetentionPreview | None = None,
    changed: bool = False,
) -> HTMLResponse:
    in_force = retention.get()
    values = {name: "" if days is None else str(days) for name, days in in_force.rules.model_dump().items()}
    return page.answer(
        "retention.html",
        status=status,
        in_force=in_force,
        typed=typed or Typed(values, set()),
        longest_days=LONGEST_DAYS,
        kinds=KINDS,
        preview=preview,
        changed=changed,
    )
