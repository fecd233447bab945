"""Forms of our own pages, and the proof that it was one of these that sent a request."""

import hmac
from typing import Annotated
from urllib.parse import parse_qsl

from fastapi import Depends, Request

from sawmill_service.access import caller_of
from sawmill_service.http.gate import SAFE_METHODS, too_large
from sawmill_service.http.problems import Refused

CSRF_FIELD, CSRF_HEADER = "csrf", "X-CSRF-Token"
# A scanner's settings, with a token.
MAX_BYTES, MAX_FIELDS = 8192, 30
# Of the form with an angle for each view: as many characters as a scan may have there, its commas as %2C.
LARGER = {"/calibrate": 400_000}


async def form(request: Request) -> dict[str, str]:
    """The fields of a form; none where the body is no form, or its length is not declared.

    Raises
    ------
    Refused
        400 `bad-form`: it cannot be read. 413 `body-too-large`: it is larger than any of ours to this path.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    length = request.headers.get("content-length")
    if media_type != "application/x-www-form-urlencoded" or length is None:
        return {}
    most = LARGER.get(request.url.path, MAX_BYTES)
    if int(length) > most:  # digits: the gate has looked
        raise too_large(most)
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
        403 `csrf`. 413 `body-too-large`: a form so large that its token is not read.
    """
    expected = caller_of(request).csrf_token
    if expected is None or request.method in SAFE_METHODS:
        return
    brought = request.headers.get(CSRF_HEADER) or (await form(request)).get(CSRF_FIELD, "")
    if not hmac.compare_digest(brought.encode(), expected.encode()):
        detail = f"in a browser's session this needs the token of that session ({CSRF_HEADER}): load the page again"
        raise Refused(403, "csrf", detail)
