"""Checks before every route: hosts, origins, keys and the length of bodies; and protective headers for browsers."""

from collections.abc import Collection, Iterable
from http import HTTPStatus
from urllib.parse import urlencode, urlsplit

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_platform.errors import StorageError
from sawmill_platform.ledger.events import acting_as
from sawmill_service.access import (
    ANYBODY,
    CHALLENGES,
    LOGIN,
    LOOPBACK,
    SESSION_COOKIE,
    Access,
    Caller,
    came_in_over_loopback,
    host_name,
)
from sawmill_service.http.bodies.body_sums import checked
from sawmill_service.http.limits.rates import Rates, who
from sawmill_service.http.middleware import Middleware
from sawmill_service.http.problems import COME_BACK, Refused, is_navigation, refusal_response
from sawmill_service.http.route_rules import NoKey, no_key, rules_of
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Stopping

# A client without a key learns nothing of the database.
KEYS_AWAY = "keys cannot be looked up now: the database does not answer; try again in a few seconds"
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
# The console's own script and styles; Swagger UI sets style attributes and shows pictures from data: and blob: URLs.
CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
PROTECTION = {
    "Content-Security-Policy": CONTENT_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}

log = structlog.get_logger(__name__)


class ProtectiveHeaders(Middleware):
    """Middleware that adds the protective headers to every answer that does not set them itself."""

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_protected(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in PROTECTION.items():
                    headers.setdefault(name, value)
                # JSON has who did what, and keys: no browser writes it to its disk.
                is_json = "json" in headers.get("Content-Type", "")
                headers.setdefault("Cache-Control", "private, no-store" if is_json else "no-cache")
            await send(message)

        await self.app(scope, receive, send_protected)


class Gate(Middleware):
    """Middleware that refuses unknown hosts, other sites' writes, requests without a key, and large or damaged bodies.

    A browser sends the password of HTTP Basic with all requests of a page, so other sites are refused first.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        settings: ServiceSettings,
        access: Access,
        open_files: Collection[str],
        refusals: Rates,
        stopping: Stopping,
    ) -> None:
        super().__init__(app)
        self.settings, self.access, self.open_files = settings, access, open_files
        self.allowed_hosts = frozenset(host.lower() for host in settings.names)
        self.refusals, self.stopping = refusals, stopping

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers, rule = Headers(scope=scope), rules_of(scope).get(scope["method"])
        largest_file = rule.max_body(self.settings) if rule and rule.max_body else None
        limit = largest_file or self.settings.max_json_bytes
        try:
            caller = await self._caller(scope, headers, limit)
        except Refused as refused:
            await _refusal(scope, self._counted(scope, refused))(scope, receive, send)
            return
        scope.setdefault("state", {})["caller"] = caller
        with acting_as(caller.acting(scope)), structlog.contextvars.bound_contextvars(key_id=caller.key_id):
            bounded = _bounded(receive, limit, self.stopping)
            sums_here = largest_file is None and scope["method"] not in SAFE_METHODS
            await self.app(scope, checked(bounded, headers) if sums_here else bounded, send)

    async def _caller(self, scope: Scope, headers: Headers, limit: int) -> Caller:
        version = scope["http_version"]
        if not version.startswith("1."):  # HTTP/2 without a proxy: its first bytes read as a request of HTTP/2.0
            raise Refused(505, "http-version-unsupported", f"this service speaks HTTP/1.1, not HTTP/{version}")
        self._check_origin(scope, headers)
        is_open = scope["path"] in self.open_files or no_key(scope) in {NoKey.MONITORING, NoKey.LOGIN}
        caller = ANYBODY if is_open else await self._known(scope, headers)
        # A path without a route is answered without reading the body.
        declared = headers.get("content-length", "0")
        if not declared.isdecimal():
            raise Refused(400, "bad-length", f"Content-Length must be a count of bytes, not {declared[:100]!r}")
        if int(declared) > limit and scope["method"] in rules_of(scope):
            raise too_large(limit)
        return caller

    async def _known(self, scope: Scope, headers: Headers) -> Caller:
        """Return the caller; the pages that explain refusals need neither a valid key nor the database."""
        try:
            return await self.access.caller(scope, headers)
        except (Refused, StorageError) as error:
            if no_key(scope) is NoKey.AFTER_REFUSAL and scope["method"] in SAFE_METHODS:
                return ANYBODY
            if isinstance(error, Refused):
                raise
            log.warning("keys-not-looked-up", reason=str(error))
            raise Refused(503, error.code, KEYS_AWAY, COME_BACK) from error

    def _counted(self, scope: Scope, refused: Refused) -> Refused:
        """Return the refusal, or 429 after too many: refused requests have the same rate as accepted ones."""
        try:
            self.refusals.take("refused requests", who(scope))
        except Refused as too_many:
            return too_many
        return refused

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        host = headers.get("host", "")
        names = self.allowed_hosts | LOOPBACK if came_in_over_loopback(scope) else self.allowed_hosts
        if host_name(host) not in names:
            raise Refused(
                421,
                "unknown-host",
                f"this service does not answer as {host[:100]!r}; SAWMILL_ALLOWED_HOSTS adds a name",
            )
        # A proxy that uses TLS need not report that to the service.
        own_schemes = {scope["scheme"], "https"} if self.settings.behind_proxy else {scope["scheme"]}
        own_origins = {f"{scheme}://{host}" for scheme in own_schemes}
        if scope["method"] not in SAFE_METHODS and _from_elsewhere(headers, own_origins):
            raise Refused(403, "other-site", "a page of another site may not change anything here")


def _refusal(scope: Scope, refused: Refused) -> Response:
    headers, unknown = Headers(scope=scope), refused.status_code == HTTPStatus.UNAUTHORIZED
    if unknown and is_navigation(headers):
        return RedirectResponse(_login_before(scope, headers), status_code=303)
    answer = refusal_response(scope["path"], refused)
    of_page = "sec-fetch-mode" in headers or SESSION_COOKIE in headers.get("cookie", "")
    for challenge in CHALLENGES if unknown else ():
        # A challenge of HTTP Basic would open a browser's password window over a page of ours.
        if challenge.startswith("Bearer") or not of_page or "authorization" in headers:
            answer.headers.append("WWW-Authenticate", challenge)
    return answer


def _login_before(scope: Scope, headers: Headers) -> str:
    """Return the path of the login, with the page to show afterwards: the form's where one was sent."""
    path, query = scope["path"], scope["query_string"].decode("latin-1")
    if of_form := scope["method"] != "GET":
        page = urlsplit(headers.get("referer", ""))
        path, query = page.path or "/", page.query
    ended = {"ended": "true"} if of_form or SESSION_COOKIE in headers.get("cookie", "") else {}
    return f"{LOGIN}?{urlencode({'next': path + (f'?{query}' if query else ''), **ended})}"


def _from_elsewhere(headers: Headers, own_origins: Iterable[str]) -> bool:
    """Return whether a browser reports that another site's page sent this; other programs report nothing."""
    if headers.get("sec-fetch-site", "none") not in {"none", "same-origin"}:
        return True
    return "origin" in headers and headers["origin"] not in own_origins


def too_large(limit: int) -> Refused:
    """Make the refusal of a body of more than `limit` bytes."""
    return Refused(413, "body-too-large", f"the body may have at most {limit} bytes")


def _bounded(receive: Receive, limit: int, stopping: Stopping) -> Receive:
    received, complete = 0, False

    async def receive_bounded() -> Message:
        nonlocal received, complete
        message = await (receive() if complete else stopping.next_part(receive))
        received += len(message.get("body", b""))
        complete = complete or not message.get("more_body", False)
        if received > limit:
            raise too_large(limit)
        return message

    return receive_bounded
