"""Forms of the service's own pages, and the token that proves that one of these pages sent a request."""

import hmac
from typing import Annotated
from urllib.parse import parse_qsl

from fastapi import Depends, Request

from sawmill_service.access import caller_of
from sawmill_service.http.gate import SAFE_METHODS, too_large
from sawmill_service.http.problems import Refused
from sawmill_service.http.route_rules import rule_of

CSRF_FIELD, CSRF_HEADER = "csrf", "X-CSRF-Token"
MAX_FIELDS = 30


async def form(request: Request) -> dict[str, str]:
    """Return the fields of a form; none if the body is no form, or its length is not declared.

    Raises
    ------
    Refused
        400 `bad-form`: the form cannot be read. 413 `body-too-large`: no page of ours sends one that large.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    length = request.headers.get("content-length")
    if media_type != "application/x-www-form-urlencoded" or length is None:
        return {}
    most = rule_of(request).max_form_bytes
    if int(length) > most:  # digits: the gate has checked that
        raise too_large(most)
    try:
        return dict(parse_qsl((await request.body()).decode(), max_num_fields=MAX_FIELDS))
    except ValueError as error:  # bytes that are not UTF-8, or too many fields
        raise Refused(400, "bad-form", f"the form cannot be read: {error}") from error


TheForm = Annotated[dict[str, str], Depends(form)]


async def check_csrf(request: Request) -> None:
    """Refuse a change that a session's cookie alone would authorise; a dependency of every route.

    A browser adds the cookie to all requests to the service, whichever site's page sends them. Only our pages know the
    session's token.
    """
    expected = caller_of(request).csrf_token
    if expected is None or request.method in SAFE_METHODS:
        return
    brought = request.headers.get(CSRF_HEADER) or (await form(request)).get(CSRF_FIELD, "")
    if not hmac.compare_digest(brought.encode(), expected.encode()):
        detail = f"in a browser's session this needs the token of that session ({CSRF_HEADER}): load the page again"
        raise Refused(403, "csrf", detail)
