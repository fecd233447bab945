"""The login of browsers: a key is brought once and becomes a session."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import RedirectResponse

from sawmill_service.access import CHALLENGES, LOGIN, LOGOUT
from sawmill_service.dependencies import TheAccess, TheCaller, TheSessionCookie, TheStore
from sawmill_service.http.forms import TheForm
from sawmill_service.http.problems import Refused
from sawmill_service.pages.frame.addresses import local_path
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_store.acting import acting_as
from sawmill_store.keys import hash_of

router = APIRouter(include_in_schema=False)


@router.get(LOGIN)
def login_page(page: ThePage, onward: Annotated[str, Query(alias="next")] = "/") -> Response:
    """A field for the key, and a button."""
    return page.answer("login.html", onward=local_path(onward), error="")


@router.post(LOGIN)
async def log_in(
    request: Request, fields: TheForm, store: TheStore, access: TheAccess, cookie: TheSessionCookie, page: ThePage
) -> Response:
    """Go on to where the browser wanted to go, with a session."""
    secret_hash, onward = hash_of(fields.get("key", "").strip()), local_path(fields.get("next", "/"))
    try:
        holder = await access.holder(request.scope, secret_hash)
    except Refused as refused:
        error, headers = f"{refused.detail}.", dict(refused.headers or {})
        return page.answer("login.html", status=refused.status_code, headers=headers, onward=onward, error=error)
    if holder is None:
        error = page.text.gettext(
            "This key opens nothing here: it is not one of this service, or it was revoked or has expired."
        )
        challenge = {"WWW-Authenticate": CHALLENGES[1]}
        return page.answer("login.html", status=401, headers=challenge, onward=onward, error=error)
    request.state.caller = holder
    before = cookie.read(request.scope, request.headers)
    with acting_as(holder.acting(request.scope)):
        opening = partial(store.sessions.open, lasting=holder.display, in_place_of=before)
        secret = await run_in_threadpool(opening, secret_hash)
    answer = RedirectResponse(onward, status_code=303)
    cookie.give(answer, request.scope, secret, lasting=holder.display)
    return answer


@router.post(LOGOUT)
def log_out(request: Request, store: TheStore, caller: TheCaller, cookie: TheSessionCookie) -> RedirectResponse:
    """End the session that the request comes by."""
    if caller.csrf_token is not None:
        store.sessions.end(cookie.read(request.scope, request.headers))
    answer = RedirectResponse(LOGIN, status_code=303)
    cookie.take_back(answer, request.scope)
    return answer
