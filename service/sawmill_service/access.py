"""Who sends a request, and what that one may do: by the token, a key, a session, or by sitting at this machine."""

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
from starlette.requests import Request
from starlette.types import Scope as RequestScope

from sawmill_platform.acting import Actor
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import StorageError
from sawmill_platform.keys.key_store import KeyStore, hash_of
from sawmill_platform.keys.sessions import Sessions
from sawmill_service.http.limits.rates import FailedLogins
from sawmill_service.http.listening import is_loopback
from sawmill_service.http.problems import Refused
from sawmill_service.http.route_rules import rule_of
from sawmill_service.http.session_cookie import SessionCookie, csrf_token

LOGIN, LOGOUT = "/login", "/logout"
# One header each: browsers do not look for a second challenge within one.
CHALLENGES = ('Basic realm="sawmill-calibration", charset="UTF-8"', 'Bearer realm="sawmill-calibration"')
# What proxies add to the requests that they pass on.
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
    """Whoever sent a request.

    Attributes
    ----------
    name : str
        The key's, or who else it is.
    scope : Scope
        What it may do.
    key_id : str or None
        None: it came without a key.
    display : bool
        Whether its key is that of a display on the wall.
    csrf_token : str or None
        What it must bring to change something; None: it came without a session, so no browser added who it is.
    """

    name: str
    scope: Scope
    key_id: str | None = None
    display: bool = False
    csrf_token: str | None = None

    def check(self, needed: Scope) -> None:
        """Refuse what needs more than this caller has.

        Raises
        ------
        Refused
            403 `scope-too-small`.
        """
        if not self.scope.covers(needed):
            detail = f"this needs a key of the scope {needed}, and {self.name!r} has {self.scope}"
            raise Refused(403, "scope-too-small", detail)

    def acting(self, scope: RequestScope) -> Actor:
        """As the audit and the jobs name it."""
        return Actor(self.name, self.key_id, client_address(scope), scope.get("state", {}).get("request_id"))


ADMINISTRATOR = Caller("the administrator", Scope.ADMIN)
# At the paths that need no key.
ANYBODY = Caller("anybody", Scope.READ)
THIS_MACHINE = Caller("somebody at this machine", Scope.ADMIN)


class Access:
    """Finds out who sends a request.

    Parameters
    ----------
    keys, sessions
        Where they are looked up.
    cookie
        In which a browser brings its session.
    token
        The first administrator's key; None: there is none.
    required
        Whether every request must bring a key. Otherwise those from this machine itself need none.
    failures
        Counts the keys that were wrong.
    """

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
        """Who sends a request: whoever's key it brings, else whoever's session.

        Raises
        ------
        Refused
            401 `token-required`: it must bring a key and brings none that is good. 429 `too-many-requests`: its
            address has brought too many that were wrong.
        StorageUnavailable
            Keys cannot be looked up.
        """
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
        """Whose key or token has this hash, if it is good now; its use is noted.

        Raises
        ------
        Refused
            429 `too-many-requests`: the address that the request came from has brought too many that were wrong.
        """
        address = client_address(scope) or "an unknown client"
        if self._failures.knows(address, secret_hash):
            return None
        found = self._of_token(secret_hash) or await run_in_threadpool(self._of_key, secret_hash)
        if found is None:
            self._failures.failed(address, secret_hash)
        return found

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
        """Whoever a session belongs to: nobody, once what opened it opens nothing any more."""
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
    """Refuse whoever has not the scope that the route needs; a dependency of every route."""
    caller_of(request).check(rule_of(request).scope)


def caller_of(request: Request) -> Caller:
    """Who sent a request that has passed the gate."""
    caller: Caller = request.state.caller
    return caller


def presented_secret(authorization: str) -> bytes:
    """What a header holds as a key: a bearer's, or the password of HTTP Basic, whoever the user is."""
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
    """Let whoever only looks look on a full disk and beside a locked database too; the log says what was not kept."""
    try:
        yield
    except StorageError as error:
        structlog.get_logger().warning("use-not-kept", what=what, reason=str(error))


def client_address(scope: RequestScope) -> str | None:
    """From which a request came; None where nothing that is an address is known."""
    client = scope.get("client")
    try:
        return str(ip_address(client[0].partition("%")[0])) if client else None
    except ValueError:  # what a proxy has put there
        return None


def host_name(host: str) -> str:
    """Return a Host header without its port, in lower case; as it is where what follows the name is no port."""
    name, _, port = host.rpartition(":")
    return (name if name and re.fullmatch("[0-9]{0,5}", port) else host).lower()


def came_in_over_loopback(scope: RequestScope) -> bool:
    """Whether the address that the client called is one of loopback, which no other machine can call."""
    server: tuple[str, int | None] | None = scope.get("server")
    return server is not None and is_loopback(server[0])


def _trace_of_a_proxy(scope: RequestScope, headers: Headers) -> str:
    """What shows that another program passed a request on; empty where nothing does."""
    if found := [name for name in FORWARDED if name in headers]:
        return found[0]
    # As nginx before 1.29.7 speaks by default, and no browser or client of this century.
    if scope.get("http_version") == "1.0":
        return "HTTP/1.0"
    if not came_in_over_loopback(scope):
        return "it was not sent to loopback"
    # A browser names the page that it shows, and a proxy its own backend.
    page = urlsplit(headers.get("origin") or headers.get("referer") or "").netloc
    host = headers.get("host", "")
    if page and page.lower() != host.lower():
        return f"a page of {page[:100]!r} sent it to {host[:100]!r}"
    return "" if host_name(host) in LOOPBACK else f"it was sent to {host[:100]!r}"


def _missing(what: str) -> Refused:
    how = f"send Authorization: Bearer KEY, or the key as the password of HTTP Basic, or log in at {LOGIN}"
    return Refused(401, "token-required", f"{what}: {how}")
