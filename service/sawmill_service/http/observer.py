"""Ids, counts, times and log lines of all requests, a 500 without details for unexpected errors, and HEAD."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPMethod, HTTPStatus
from uuid import uuid4

import anyio
import structlog
from anyio import BrokenResourceError
from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars, clear_contextvars

from sawmill_service.access import client_address
from sawmill_service.http.middleware import Middleware
from sawmill_service.http.problems import problem_response

CLIENT_GONE = 499  # nobody reads this status; it keeps broken connections apart in the counts
# Unknown methods are counted as one: each value of a label is kept for good.
METHODS = frozenset(HTTPMethod)
# Machines request these every few seconds: a line for each would hide the rest of the log.
QUIET_ROUTES = frozenset({"/health/live", "/health/ready", "/metrics"})
# The log has the address of a client that got one of these.
REFUSALS = frozenset({401, 403, 421, 429})
log = structlog.get_logger(__name__)


class Observer(Middleware):
    """Middleware that counts and times requests by route, and logs and answers unexpected errors."""

    def __init__(self, app: ASGIApp, *, registry: CollectorRegistry) -> None:
        super().__init__(app)
        self.requests = Counter(
            "sawmill_http_requests",
            "Requests that this process answered; status 499: the client left.",
            ["method", "route", "status"],
            registry=registry,
        )
        self.seconds = Histogram(
            "sawmill_http_request_seconds",
            "Seconds until an answer was complete.",
            ["method", "route"],
            registry=registry,
        )

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        status: int | None = None
        sent_bytes = 0

        async def send_observed(message: Message) -> None:
            nonlocal status, sent_bytes
            if message["type"] == "http.response.start":
                status = message["status"]
            sent_bytes += len(message.get("body", b""))
            await send(message)

        started = time.perf_counter()
        try:
            try:
                await self.app(scope, receive, send_observed)
            except* BrokenResourceError:
                pass  # the client left while an event waited in FastAPI's stream, which is how streams end
        except ClientDisconnect:
            status = CLIENT_GONE
        except Exception:
            log.exception("request-failed", method=_method(scope), route=_route(scope), **_who_and_what(scope))
            if status is not None:
                raise  # half an answer is sent: only a broken connection shows the error to the client
            status = 500
            detail = f"something went wrong inside the service; its log has more under {scope['state']['request_id']}"
            await problem_response(scope["path"], 500, "internal", detail)(scope, receive, send)
        finally:
            self._tell(scope, status, time.perf_counter() - started, sent_bytes)

    def _tell(self, scope: Scope, status: int | None, seconds: float, sent_bytes: int) -> None:
        route, method = _route(scope), _method(scope)
        self.requests.labels(method, route, str(status)).inc()
        self.seconds.labels(method, route).observe(seconds)
        if route in QUIET_ROUTES and status == HTTPStatus.OK:
            return
        log.info(
            "request",
            method=method,
            route=route,
            status=status,
            seconds=round(seconds, 4),
            bytes=sent_bytes,
            **_who_and_what(scope),
            **({"address": client_address(scope)} if status in REFUSALS else {}),
        )


def _route(scope: Scope) -> str:
    """Return the path's pattern: the path itself comes from the client, and may have a secret."""
    return getattr(scope.get("route"), "path", "unmatched")


def _method(scope: Scope) -> str:
    return scope["method"] if scope["method"] in METHODS else "other"


def _who_and_what(scope: Scope) -> dict[str, str]:
    """Return the caller's key and the job that was queued, if there are any."""
    state = scope["state"]
    ids = {"key_id": getattr(state.get("caller"), "key_id", None), "job_id": state.get("job_id")}
    return {name: value for name, value in ids.items() if value is not None}


HEADER = "X-Request-Id"
# Ids that a proxy or a client may give: they can neither end nor fill a header or a line of the log.
_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")


class RequestIds(Middleware):
    """Middleware that gives each request an id, and puts the ids of request, key and job on the answer.

    The id is the client's if that is safe. Until the request is answered, `structlog.contextvars` has the id as
    `request_id`, also in the threads that handle the request, and so has `scope["state"]`.
    """

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        client_id = Headers(scope=scope).get(HEADER)
        with named_request(client_id if client_id is not None and _SAFE.fullmatch(client_id) else None) as request_id:
            state = scope.setdefault("state", {})
            state["request_id"] = request_id

            async def send_named(message: Message) -> None:
                if message["type"] == "http.response.start":
                    key_id, job_id = getattr(state.get("caller"), "key_id", None), state.get("job_id")
                    ids = {HEADER: request_id, "X-Key-Id": key_id, "X-Job-Id": job_id}
                    MutableHeaders(scope=message).update({name: value for name, value in ids.items() if value})
                await send(message)

            await self.app(scope, receive, send_named)


@contextmanager
def named_request(client_id: str | None = None) -> Iterator[str]:
    """Give all lines of the log and problems within the block this id, or a new one."""
    request_id = client_id or uuid4().hex
    # A request that follows directly after another one starts in the context of that one.
    clear_contextvars()
    with bound_contextvars(request_id=request_id):
        yield request_id


class Heads(Middleware):
    """Middleware that answers HEAD as GET, but does not start the file or stream after the headers."""

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return
        # Ranges are for GET only (RFC 9110, section 14.2).
        headers = [(name, value) for name, value in scope["headers"] if name != b"range"]
        inner = {**scope, "method": "GET", "headers": headers}
        with anyio.CancelScope() as rest:

            async def send_head(message: Message) -> None:
                if message["type"] == "http.response.start":
                    scope.update({name: inner[name] for name in ("route",) if name in inner})
                    await send(message)
                    await send({"type": "http.response.body", "body": b"", "more_body": False})
                    rest.cancel()

            await self.app(inner, receive, send_head)
