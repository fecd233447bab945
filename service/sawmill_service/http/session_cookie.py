"""The cookie that a login gives a browser, and the token that its forms and scripts bring beside it."""

import hashlib
import hmac

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.types import Scope

NAME = "sawmill_session"
# With this prefix browsers let neither plain HTTP nor another host of the same domain set it.
SECURE_NAME = f"__Host-{NAME}"
# Browsers keep no cookie longer; a display's is given anew with each page.
DISPLAY_MAX_AGE_S = 400 * 86400


class SessionCookie:
    """Written into answers and read from requests.

    It is sent along when somebody follows a link (`SameSite=Lax`), so that one in a mail does not lead to the login.
    Nothing is changed by following links; what changes something needs the token of the session (`csrf_token`) and must
    not come from another site's page (`gate`).

    Parameters
    ----------
    public_url
        Where it begins with `https:`, the cookie is for TLS alone, whatever the proxy speaks to the service.
    """

    def __init__(self, public_url: str | None) -> None:
        self._always_secure = public_url is not None and public_url.startswith("https:")

    def read(self, scope: Scope, headers: Headers) -> str:
        """The session's secret, as a browser brought it; empty where it brought none."""
        return cookie_parser(headers.get("cookie", "")).get(self._name(scope), "")

    def give(self, answer: Response, scope: Scope, secret: str, *, lasting: bool) -> None:
        """Have a browser keep it until it is closed, or for long where the session is a display's."""
        self._set(answer, scope, secret, DISPLAY_MAX_AGE_S if lasting else None)

    def take_back(self, answer: Response, scope: Scope) -> None:
        """Have a browser forget it."""
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
    """What requests of a session bring to change something: it tells nothing about the session's secret."""
    return hmac.new(secret.encode(), b"csrf", hashlib.sha256).hexdigest()
