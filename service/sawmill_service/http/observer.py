"""Counts, times and log lines of all requests, and a 500 without details for unexpected errors."""

import time
from http import HTTPMethod, HTTPStatus

import structlog
from anyio import BrokenResourceError
from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.access import client_address
from sawmill_service.http.problems import problem_response

CLIENT_GONE = 499  # nobody reads this status; it keeps broken connections apart in the counts
# Unknown methods are counted as one: each value of a label is kept for good.
METHODS = frozenset(HTTPMethod)
# Machines request these every few seconds: a line for each would hide the rest of the log.
QUIET_ROUTES = frozenset({"/health/live", "/health/ready", "/metrics"})
# The log has the address of a client that got one of these.
REFUSALS = frozenset({401, 403, 421, 429})
log = structlog.get_logger(__name__)


class Observer:
    """Middleware that counts and times requests by route, and logs and answers unexpected errors."""

    def __init__(self, app: ASGIApp, *, registry: CollectorRegistry) -> None:
        self.app = app
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

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
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
            await _internal_error(scope)(scope, receive, send)
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


def _internal_error(scope: Scope) -> ASGIApp:
    detail = f"something went wrong inside the service; its log has more under {scope['state']['request_id']}"
    return problem_response(scope["path"], 500, "internal", detail)
