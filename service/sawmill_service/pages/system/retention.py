"""`/retention`: how long things are kept. A page asks for each confirmation with the number of items."""

from fastapi.responses import HTMLResponse, RedirectResponse
from pydantic import ValidationError

from sawmill_contracts.retention import RetentionAsk, RetentionPreview, RetentionRules
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict
from sawmill_service.dependencies import TheRetention
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import locale_of
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.system.retention_form import KINDS, REASONS, RetentionForm, form_of, read_form

PATH = "/retention"

router = Router(include_in_schema=False, reading=Scope.ADMIN)


@router.get(PATH)
def retention(page: ThePage, retention: TheRetention) -> HTMLResponse:
    """Show the rules in force, and the form for new ones."""
    return _answer(page, retention)


@router.post(PATH, needs=Scope.ADMIN)
def try_rules(page: ThePage, retention: TheRetention, typed: TheForm) -> HTMLResponse:
    """Show what typed rules would remove, or the form again with what is wrong; nothing is removed."""
    form, rules = read_form(typed, page.text)
    if form.errors:
        return _answer(page, retention, status=422, form=form)
    return _answer(page, retention, form=form, preview=retention.preview(rules))


@router.post(f"{PATH}/confirmed", needs=Scope.ADMIN, response_model=None)
def confirm(page: ThePage, retention: TheRetention, typed: TheForm) -> HTMLResponse | RedirectResponse:
    """Put the rules into force, or show the new number if they would now remove more than was confirmed."""
    form, rules = read_form(typed, page.text)
    if form.errors:
        return _answer(page, retention, status=422, form=form)
    try:
        retention.replace(
            RetentionAsk.model_validate(rules.model_dump() | {"remove_at_most": typed.get("remove_at_most", 0)})
        )
    except (Conflict, ValidationError):
        return _answer(page, retention, status=409, form=form, preview=retention.preview(rules), changed=True)
    return RedirectResponse(PATH, status_code=303)


def _answer(
    page: PageFrame,
    retention: TheRetention,
    *,
    status: int = 200,
    form: RetentionForm | None = None,
    preview: RetentionPreview | None = None,
    changed: bool = False,
) -> HTMLResponse:
    in_force = retention.get()
    return page.answer(
        "retention.html",
        status=status,
        in_force=in_force,
        form=form or form_of(in_force.rules, locale_of(page.language)),
        fields=RetentionRules.model_fields,
        kinds=KINDS,
        reasons=REASONS,
        preview=preview,
        changed=changed,
    )
