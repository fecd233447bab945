"""Access control: who sends a request (by token, key, session or this machine), what the caller may do, the cookie."""

import hashlib
import hmac
import re
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from ipaddress import ip_address
from urllib.parse import urlsplit

import structlog
from fastapi.concurrency import run_in_threadpool
from pydantic import SecretStr
from starlette.datastructures import Headers
from starlette.requests import Request, cookie_parser
from starlette.responses import Response
from starlette.types import Scope as RequestScope

from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import StorageError
from sawmill_platform.keys.key_store import KeyStore, Sessions, hash_of
from sawmill_platform.ledger.events import Actor
from sawmill_service.http.limits.rates import FailedLogins
from sawmill_service.http.listening import is_loopback
from sawmill_service.http.problems import Refused
from sawmill_service.http.route_rules import rule_of

SESSION_COOKIE = "sawmill_session"
# With this prefix browsers let neither plain HTTP nor another host of the same domain set it.
SECURE_SESSION_COOKIE = f"__Host-{SESSION_COOKIE}"
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

    def read(self, scope: RequestScope, headers: Headers) -> str:
        """Return the session's secret from the cookie; empty without one."""
        return cookie_parser(headers.get("cookie", "")).get(self._name(scope), "")

    def give(self, answer: Response, scope: RequestScope, secret: str, *, lasting: bool) -> None:
        """Set the cookie until the browser is closed, or for 400 days for a display."""
        self._set(answer, scope, secret, DISPLAY_MAX_AGE_S if lasting else None)

    def take_back(self, answer: Response, scope: RequestScope) -> None:
        """Delete the cookie."""
        self._set(answer, scope, "", 0)

    def _set(self, answer: Response, scope: RequestScope, value: str, max_age_s: int | None) -> None:
        answer.set_cookie(
            self._name(scope),
            value,
            max_age=max_age_s,
            path="/",
            secure=self._is_secure(scope),
            httponly=True,
            samesite="lax",
        )

    def _name(self, scope: RequestScope) -> str:
        return SECURE_SESSION_COOKIE if self._is_secure(scope) else SESSION_COOKIE

    def _is_secure(self, scope: RequestScope) -> bool:
        return self._always_secure or scope["scheme"] == "https"


def csrf_token(secret: str) -> str:
    """Return the token of a session that changes need; the session's secret cannot be derived from it."""
    return hmac.new(secret.encode(), b"csrf", hashlib.sha256).hexdigest()


LOGIN, LOGOUT = "/login", "/logout"
# Separate headers: browsers do not search one header for a second challenge.
CHALLENGES = ('Basic realm="sawmill-calibration", charset="UTF-8"', 'Bearer realm="sawmill-calibration"')
# Headers that proxies add to the requests that they forward.
FORWARDED = (
    "forwarded",
    "via",
    "x-client-ip",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-forwarded-port",
    "x-forwarded-proto",
    "x-forwarded-server",
    "x-original-forwarded-for",
    "x-real-ip",
)
LOOPBACK = frozenset({"127.0.0.1", "localhost", "[::1]"})


@dataclass(frozen=True)
class Caller:
    """Sender of a request."""

    name: str  # name of the key, or another name of the sender
    scope: Scope
    key_id: str | None = None  # id of the key; None where the request came without a key
    display: bool = False  # True if the key belongs to a display on the wall
    # Token that a change must bring; None where the request came without a session, so that no browser added the
    # credentials by itself.
    csrf_token: str | None = None

    def check(self, needed: Scope) -> None:
        """Refuse a request that needs a larger scope than the caller has."""
        if not self.scope.covers(needed):
            raise Refused(
                403, "scope-too-small", f"this needs a key of the scope {needed}, and {self.name!r} has {self.scope}"
            )

    def acting(self, scope: RequestScope) -> Actor:
        """Return the caller as audit entries and jobs name the caller."""
        return Actor(self.name, self.key_id, client_address(scope), scope.get("state", {}).get("request_id"))


ADMINISTRATOR = Caller("the administrator", Scope.ADMIN)
# The caller at paths that need no key.
ANYBODY = Caller("anybody", Scope.READ)
THIS_MACHINE = Caller("somebody at this machine", Scope.ADMIN)


class Access:
    """Identification of the sender of a request."""

    def __init__(
        self,
        keys: KeyStore,
        sessions: Sessions,
        cookie: SessionCookie,
        *,
        token: SecretStr | None,
        required: bool,
        failures: FailedLogins,
    ) -> None:
        self._keys = keys
        self._sessions = sessions
        self._cookie = cookie
        self._token_hash = None if token is None else hash_of(token.get_secret_value())
        self._required = required or token is not None
        self._failures = failures

    async def caller(self, scope: RequestScope, headers: Headers) -> Caller:
        """Find the sender of a request by the key in it, else by its session."""
        if secret := presented_secret(headers.get("authorization", "")):
            return await self._opened_by(scope, secret)
        cookie = self._cookie.read(scope, headers)
        if cookie and (caller := await run_in_threadpool(self._in_session, cookie)):
            return caller
        if self._required:
            raise _missing("the session has ended" if cookie else "the key is missing")
        if passed_on := _trace_of_a_proxy(scope, headers):
            raise _missing(f"the request came through a proxy ({passed_on}), and behind one every request needs a key")
        return THIS_MACHINE

    async def holder(self, scope: RequestScope, secret_hash: str) -> Caller | None:
        """Find the caller whose key or token has this hash, and note the use; None where it is not valid now."""
        address = client_address(scope) or "an unknown client"
        if self._failures.knows(address, secret_hash):
            return None
        caller = self._of_token(secret_hash) or await run_in_threadpool(self._of_key, secret_hash)
        if caller is None:
            self._failures.failed(address, secret_hash)
        return caller

    async def _opened_by(self, scope: RequestScope, secret: bytes) -> Caller:
        caller = await self.holder(scope, hash_of(secret.decode("latin-1")))
        if caller is None:
            raise _missing("the key is not one of this service, or has ended")
        return caller

    def _of_token(self, secret_hash: str) -> Caller | None:
        matches = self._token_hash is not None and hmac.compare_digest(secret_hash, self._token_hash)
        return ADMINISTRATOR if matches else None

    def _of_key(self, secret_hash: str) -> Caller | None:
        key = self._keys.good(secret_hash)
        if key is None:
            return None
        with _unless_it_cannot_be_written("a key's use"):
            self._keys.used(key)
        return Caller(key.name, key.scope, key.id, display=key.display)

    def _in_session(self, secret: str) -> Caller | None:
        """Find the caller to whom a session belongs; None once the key that opened it is no longer valid."""
        session = self._sessions.find(secret)
        if session is None:
            return None
        caller = self._of_token(session.opened_by_hash) or self._of_key(session.opened_by_hash)
        if caller is None:
            return None
        with _unless_it_cannot_be_written("a session's use"):
            self._sessions.renew(session)
        return replace(caller, csrf_token=csrf_token(secret))


async def check_scope(request: Request) -> None:
    """Refuse a caller without the scope that the route needs; a dependency of every route."""
    caller_of(request).check(rule_of(request).scope)


def caller_of(request: Request) -> Caller:
    """Return the sender of a request that has passed the gate."""
    caller: Caller = request.state.caller
    return caller


def presented_secret(authorization: str) -> bytes:
    """Return the key in an `Authorization` header: a bearer token, or the password of HTTP Basic for any user."""
    scheme, _, credentials = authorization.partition(" ")
    if scheme.lower() == "bearer":
        return credentials.strip().encode("latin-1")
    if scheme.lower() == "basic":
        try:
            return b64decode(credentials, validate=True).partition(b":")[2]
        except ValueError:  # no base64, or no ASCII at all
            return b""
    return b""


@contextmanager
def _unless_it_cannot_be_written(what: str) -> Iterator[None]:
    """Log a storage error and continue: reading must work with a full disk and a locked database too."""
    try:
        yield
    except StorageError as error:
        structlog.get_logger().warning("use-not-kept", what=what, reason=str(error))


def client_address(scope: RequestScope) -> str | None:
    """Return the address from which a request came; None where no valid address is known."""
    client = scope.get("client")
    try:
        return str(ip_address(client[0].partition("%")[0])) if client else None
    except ValueError:  # a text that a proxy has put there
        return None


def host_name(host: str) -> str:
    """Return the name in a Host header, in lower case; the whole header where no port follows the name."""
    name, _, port = host.rpartition(":")
    return (name if name and re.fullmatch("[0-9]{0,5}", port) else host).lower()


def came_in_over_loopback(scope: RequestScope) -> bool:
    """Return whether the client called a loopback address, which no other machine can call."""
    server: tuple[str, int | None] | None = scope.get("server")
    return server is not None and is_loopback(server[0])


def _trace_of_a_proxy(scope: RequestScope, headers: Headers) -> str:
    """Return the evidence that another program forwarded a request; empty where there is none."""
    if forwarding := [name for name in FORWARDED if name in headers]:
        return forwarding[0]
    # nginx before 1.29.7 uses HTTP/1.0 by default; current browsers and clients do not.
    if scope.get("http_version") == "1.0":
        return "HTTP/1.0"
    if not came_in_over_loopback(scope):
        return "it was not sent to loopback"
    # A browser names the page that it shows in Origin or Referer; a proxy names its own backend in Host.
    page = urlsplit(headers.get("origin") or headers.get("referer") or "").netloc
    host = headers.get("host", "")
    if page and page.lower() != host.lower():
        return f"a page of {page[:100]!r} sent it to {host[:100]!r}"
    return "" if host_name(host) in LOOPBACK else f"it was sent to {host[:100]!r}"


def _missing(what: str) -> Refused:
    how = f"send Authorization: Bearer KEY, or the key as the password of HTTP Basic, or log in at {LOGIN}"
    return Refused(401, "token-required", f"{what}: {how}")
