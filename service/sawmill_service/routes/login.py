"""The login of browsers: a key is brought once and becomes a session."""

import re
from collections.abc import Mapping
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_service.access import CHALLENGES, LOGIN, LOGOUT
from sawmill_service.dependencies import TheAccess, TheCaller, TheSessionCookie, TheStore
from sawmill_service.forms import TheForm
from sawmill_service.operator_page import TEMPLATES
from sawmill_service.problems import Refused
from sawmill_worker.storage.acting import acting_as
from sawmill_worker.storage.keys import hash_of

router = APIRouter(include_in_schema=False)

UNKNOWN = "This key opens nothing here: it is not one of this service, or it was revoked or has expired."


@router.get(LOGIN)
def login_page(onward: Annotated[str, Query(alias="next")] = "/") -> HTMLResponse:
    """A field for the key, and a button."""
    return _login_page(_local(onward))


@router.post(LOGIN)
async def log_in(
    request: Request, fields: TheForm, store: TheStore, access: TheAccess, cookie: TheSessionCookie
) -> Response:
    """Go on to where the browser wanted to go, with a session."""
    secret_hash, onward = hash_of(fields.get("key", "").strip()), _local(fields.get("next", "/"))
    try:
        holder = await access.holder(request.scope, secret_hash)
    except Refused as refused:
        return _login_page(onward, f"{refused.detail}.", refused.status_code, refused.headers)
    if holder is None:
        return _login_page(onward, UNKNOWN, 401, {"WWW-Authenticate": CHALLENGES[1]})
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


def _login_page(
    onward: str, error: str = "", status: int = 200, headers: Mapping[str, str] | None = None
) -> HTMLResponse:
    html = TEMPLATES.get_template("login.html").render(onward=onward, error=error)
    return HTMLResponse(html, status, {"Cache-Control": "no-store", **(headers or {})})


def _local(path: str) -> str:
    r"""A path of this service, else the operator's page: no login leads to another site, as `//` and `/\` would."""
    return path if re.fullmatch(r"/(?!/)[!-\[\]-~]*", path) else "/"
