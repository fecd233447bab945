"""Forms of our own pages, and the proof that it was one of these that sent a request."""

import hmac
from typing import Annotated
from urllib.parse import parse_qsl

from fastapi import Depends, Request

from sawmill_service.access import caller_of
from sawmill_service.gate import SAFE_METHODS
from sawmill_service.problems import Refused

CSRF_FIELD, CSRF_HEADER = "csrf", "X-CSRF-Token"
# A scanner's settings, with a token.
MAX_BYTES, MAX_FIELDS = 8192, 30


async def form(request: Request) -> dict[str, str]:
    """The fields of a form; none where the body is no form, or larger than any of ours.

    Raises
    ------
    Refused
        400 `bad-form`: it cannot be read.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    length = int(request.headers.get("content-length", MAX_BYTES + 1))  # digits: the gate has looked
    if media_type != "application/x-www-form-urlencoded" or length > MAX_BYTES:
        return {}
    try:
        return dict(parse_qsl((await request.body()).decode(), max_num_fields=MAX_FIELDS))
    except ValueError as error:  # bytes that are not UTF-8, or too many fields
        raise Refused(400, "bad-form", f"the form cannot be read: {error}") from error


TheForm = Annotated[dict[str, str], Depends(form)]


async def check_csrf(request: Request) -> None:
    """Refuse what a session's cookie alone would change; a dependency of every route.

    A browser adds the cookie to whatever any page has it send. Only our pages know the token beside it.

    Raises
    ------
    Refused
        403 `csrf`.
    """
    expected = caller_of(request).csrf_token
    if expected is None or request.method in SAFE_METHODS:
        return
    brought = request.headers.get(CSRF_HEADER) or (await form(request)).get(CSRF_FIELD, "")
    if not hmac.compare_digest(brought.encode(), expected.encode()):
        detail = f"in a browser's session this needs the token of that session ({CSRF_HEADER}): load the page again"
        raise Refused(403, "csrf", detail)
