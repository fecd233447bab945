"""Cookie that a login gives a browser, and the token that forms and scripts send in addition."""

import hashlib
import hmac

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.types import Scope

NAME = "sawmill_session"
# With this prefix browsers let neither plain HTTP nor another host of the same domain set it.
SECURE_NAME = f"__Host-{NAME}"
# Browsers keep no cookie longer; a display gets its cookie again with each page.
DISPLAY_MAX_AGE_S = 400 * 86400


class SessionCookie:
    """Cookie of a session: written into answers and read from requests.

    Browsers send the cookie when a person follows a link (`SameSite=Lax`), so that a link in a mail works without a new
    login. Following links changes nothing; a request that changes something needs the token of the session
    (`csrf_token`) and must not come from another site's page (`gate`).
    """

    def __init__(self, public_url: str | None) -> None:
        self._always_secure = public_url is not None and public_url.startswith("https:")

    def read(self, scope: Scope, headers: Headers) -> str:
        """Return the session's secret from the cookie; empty without one."""
        return cookie_parser(headers.get("cookie", "")).get(self._name(scope), "")

    def give(self, answer: Response, scope: Scope, secret: str, *, lasting: bool) -> None:
        """Set the cookie until the browser is closed, or for 400 days for a display."""
        self._set(answer, scope, secret, DISPLAY_MAX_AGE_S if lasting else None)

    def take_back(self, answer: Response, scope: Scope) -> None:
        """Delete the cookie."""
        self._set(answer, scope, "", 0)

    def _set(self, answer: Response, scope: Scope, value: str, max_age_s: int | None) -> None:
        answer.set_cookie(
            self._name(scope),
            value,
            max_age=max_age_s,
            path="/",
            secure=self._is_secure(scope),
            httponly=True,
            samesite="lax",
        )

    def _name(self, scope: Scope) -> str:
        return SECURE_NAME if self._is_secure(scope) else NAME

    def _is_secure(self, scope: Scope) -> bool:
        return self._always_secure or scope["scheme"] == "https"


def csrf_token(secret: str) -> str:
    """Return the token of a session that changes need; the session's secret cannot be derived from it."""
    return hmac.new(secret.encode(), b"csrf", hashlib.sha256).hexdigest()
