"""Counts and times every request, and turns what no handler expected into a 500 that gives nothing away."""

import time
from collections.abc import Callable, Iterable, Mapping
from http import HTTPMethod
from uuid import uuid4

import structlog
from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from sawmill_service.problems import problem_response
from sawmill_worker.contracts.jobs import JobState

CLIENT_GONE = 499  # nobody reads this status; it keeps broken connections apart in the counts
# What clients invent beside them is counted as one method: each value of a label is kept for good.
METHODS = frozenset(HTTPMethod)
log = structlog.get_logger(__name__)


class JobsByState(Collector):
    """Counts the jobs in each state when the metrics are read."""

    def __init__(self, counts: Callable[[], Mapping[JobState, int]]) -> None:
        self.counts = counts

    def describe(self) -> Iterable[GaugeMetricFamily]:
        """Say what will come without looking."""
        yield self._family()

    def collect(self) -> Iterable[GaugeMetricFamily]:
        """Look, and answer one gauge with a value for each state."""
        family = self._family()
        for state, count in self.counts().items():
            family.add_metric([state], count)
        yield family

    @staticmethod
    def _family() -> GaugeMetricFamily:
        return GaugeMetricFamily("sawmill_jobs", "Jobs by state.", labels=["state"])


class Observer:
    """Count and time requests by route; log and answer what went wrong inside."""

    def __init__(self, app: ASGIApp, *, registry: CollectorRegistry) -> None:
        self.app = app
        self.requests = Counter(
            "sawmill_http_requests", "HTTP requests.", ["method", "route", "status"], registry=registry
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

        async def send_observed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        started = time.perf_counter()
        try:
            await self.app(scope, receive, send_observed)
        except ClientDisconnect:
            status = CLIENT_GONE
            log.info("client-gone", method=scope["method"], path=scope["path"])
        except Exception:
            reference = uuid4().hex
            log.exception("request-failed", method=scope["method"], path=scope["path"], reference=reference)
            if status is not None:
                raise  # half an answer is out: only a broken connection tells the client
            status = 500
            await _internal_error(scope["path"], reference)(scope, receive, send)
        finally:
            route = getattr(scope.get("route"), "path", "unmatched")
            method = scope["method"] if scope["method"] in METHODS else "other"
            self.requests.labels(method, route, str(status)).inc()
            self.seconds.labels(method, route).observe(time.perf_counter() - started)


def _internal_error(path: str, reference: str) -> ASGIApp:
    detail = f"something went wrong inside the service; its log has more under {reference}"
    return problem_response(path, 500, "internal", detail)
