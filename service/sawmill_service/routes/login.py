"""Login of browsers: a key is entered once and opens a session."""

from functools import partial
from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse

from sawmill_platform.contracts.keys import Scope
from sawmill_platform.keys.key_store import hash_of, hash_of_link
from sawmill_platform.ledger.events import acting_as
from sawmill_service.access import CHALLENGES, LOGIN, LOGOUT
from sawmill_service.dependencies import TheAccess, TheCaller, TheSessionCookie, TheStore
from sawmill_service.http.bodies.forms import TheForm
from sawmill_service.http.problems import Refused
from sawmill_service.http.route_rules import NoKey, Router
from sawmill_service.pages.frame.page_frame import ThePage, local_path

# Files that the login page loads.
FILES = frozenset(
    f"/static/{name}"
    for name in ("mark.svg", "pages/base.css", "pages/dark.css", "pages/login.js", "pages/menus.js", "pages/time.js")
)

router = Router(include_in_schema=False)


@router.get(LOGIN, needs=NoKey.LOGIN)
def login_page(page: ThePage, onward: Annotated[str, Query(alias="next")] = "/", *, ended: bool = False) -> Response:
    """Show a field for the key, and a button."""
    return page.answer("login.html", onward=local_path(onward), error="", ended=ended)


@router.get(f"{LOGIN}/{{link}}", needs=NoKey.LOGIN)
def display_page(link: Annotated[str, Path(max_length=64, pattern=r"^[\w-]+$")], page: ThePage) -> Response:
    """Show one button that logs a display in; a program that only looks into the link does not use it up."""
    return page.answer("login_display.html", link=link)


@router.post(LOGIN, needs=NoKey.LOGIN)
async def log_in(
    request: Request, fields: TheForm, store: TheStore, access: TheAccess, cookie: TheSessionCookie, page: ThePage
) -> Response:
    """Open a session by a key or a link, and lead the browser to the page that it requested."""
    onward, link = local_path(fields.get("next", "/")), fields.get("link")
    secret_hash = hash_of(fields.get("key", "").strip())
    if link is not None:
        opener = await run_in_threadpool(store.sessions.use_link, link)
        secret_hash = hash_of_link(link) if opener is None else opener
    try:
        holder = await access.holder(request.scope, secret_hash)
    except Refused as refused:
        error, headers = f"{refused.detail}.", dict(refused.headers or {})
        return page.answer(
            "login.html", status=refused.status_code, headers=headers, onward=onward, error=error, ended=False
        )
    if holder is None:
        error = page.text.gettext(
            "This key opens nothing here: it is not one of this service, or it was revoked or has expired."
        )
        if link is not None:
            error = page.text.gettext("This link was used already, or is older than ten minutes: make a new one.")
        challenge = {"WWW-Authenticate": CHALLENGES[1]}
        return page.answer("login.html", status=401, headers=challenge, onward=onward, error=error, ended=False)
    request.state.caller = holder
    before = cookie.read(request.scope, request.headers)
    with acting_as(holder.acting(request.scope)):
        opening = partial(store.sessions.open, lasting=holder.display, in_place_of=before)
        secret = await run_in_threadpool(opening, secret_hash)
    answer = RedirectResponse(onward, status_code=303)
    cookie.give(answer, request.scope, secret, lasting=holder.display)
    return answer


@router.post(LOGOUT, needs=Scope.READ)
def log_out(request: Request, store: TheStore, caller: TheCaller, cookie: TheSessionCookie) -> RedirectResponse:
    """End the session of the request."""
    if caller.csrf_token is not None:
        store.sessions.end(cookie.read(request.scope, request.headers))
    answer = RedirectResponse(LOGIN, status_code=303)
    cookie.take_back(answer, request.scope)
    return answer
