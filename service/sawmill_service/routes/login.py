"""The login of browsers: a key is brought once and becomes a session."""

import re
from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_service.access import CHALLENGES, LOGIN, LOGOUT
from sawmill_service.dependencies import TheAccess, TheCaller, TheSessionCookie, TheStore
from sawmill_service.forms import TheForm
from sawmill_service.operator_page import TEMPLATES
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
    holder = await access.holder(secret_hash)
    if holder is None:
        return _login_page(onward, UNKNOWN, HTTPStatus.UNAUTHORIZED)
    before = cookie.read(request.scope, request.headers)
    with acting_as(holder.acting(request.scope)):
        opening = partial(store.sessions.open, lasting=holder.display, in_place_of=before)
        secret = await run_in_threadpool(opening, secret_hash)
    answer = RedirectResponse(onward, HTTPStatus.SEE_OTHER)
    cookie.give(answer, request.scope, secret, lasting=holder.display)
    return answer


@router.post(LOGOUT)
def log_out(request: Request, store: TheStore, caller: TheCaller, cookie: TheSessionCookie) -> RedirectResponse:
    """End the session that the request comes by."""
    if caller.csrf_token is not None:
        store.sessions.end(cookie.read(request.scope, request.headers))
    answer = RedirectResponse(LOGIN, HTTPStatus.SEE_OTHER)
    cookie.take_back(answer, request.scope)
    return answer


def _login_page(onward: str, error: str = "", status: HTTPStatus = HTTPStatus.OK) -> HTMLResponse:
    html = TEMPLATES.get_template("login.html").render(onward=onward, error=error)
    headers = {"Cache-Control": "no-store"} | ({"WWW-Authenticate": CHALLENGES[1]} if error else {})
    return HTMLResponse(html, status, headers)


def _local(path: str) -> str:
    r"""A path of this service, else the operator's page: no login leads to another site, as `//` and `/\` would."""
    return path if re.fullmatch(r"/(?!/)[!-\[\]-~]*", path) else "/"
