"""Look of the pages in one browser: language and colours, kept in cookies."""

from typing import Annotated

from fastapi import Query, Request
from fastapi.responses import RedirectResponse

from sawmill_service.http.route_rules import NoKey, Router
from sawmill_service.pages.frame.addresses import (
    local_path,
)
from sawmill_service.pages.frame.languages import (
    LANGUAGES,
)
from sawmill_service.pages.frame.page_frame import (
    LANGUAGE_COOKIE,
    THEME_COOKIE,
    THEMES,
)

LOOK = "/look"
YEAR_S = 365 * 86400

router = Router(include_in_schema=False)


@router.get(LOOK, needs=NoKey.LOGIN)
def look(
    request: Request,
    language: Annotated[str, Query()] = "",
    theme: Annotated[str, Query()] = "",
    onward: Annotated[str, Query(alias="next")] = "/",
) -> RedirectResponse:
    """Keep the language and the theme that are known, and return to the page."""
    answer = RedirectResponse(local_path(onward), status_code=303)
    for name, value, known in [(LANGUAGE_COOKIE, language, LANGUAGES), (THEME_COOKIE, theme, THEMES)]:
        if value in known:
            answer.set_cookie(name, value, max_age=YEAR_S, secure=request.url.scheme == "https", samesite="lax")
    return answer
