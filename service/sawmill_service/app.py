"""Assembly of the service from its parts. Nothing happens at import."""

from functools import cache
from pathlib import Path

import fastapi_offline
from fastapi import APIRouter, Depends
from prometheus_client import CollectorRegistry
from starlette.routing import BaseRoute
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_service import retention
from sawmill_service.access import Access, SessionCookie, check_scope
from sawmill_service.dependencies import Wake
from sawmill_service.event_feed import EventFeed, StreamTimes
from sawmill_service.http.bodies.forms import check_csrf
from sawmill_service.http.bodies.sent_content import SlowBodies
from sawmill_service.http.bodies.sent_json import check_body, check_query
from sawmill_service.http.document.openapi_document import Application
from sawmill_service.http.gate import Gate, ProtectiveHeaders
from sawmill_service.http.limits.admission import Admission
from sawmill_service.http.limits.rates import FailedLogins, Rates
from sawmill_service.http.limits.transfers import Transfers
from sawmill_service.http.observer import Heads, Observer, RequestIds
from sawmill_service.http.problems import install
from sawmill_service.http.repeats import install as install_repeats
from sawmill_service.http.responses.conditional import Digests
from sawmill_service.http.responses.drawn import MemoryBudget
from sawmill_service.http.responses.waiting import JobEnds
from sawmill_service.http.route_rules import RouteRules, check_method
from sawmill_service.measures import Measures
from sawmill_service.pages.all_pages import PAGES
from sawmill_service.pages.problem_pages import ProblemPages
from sawmill_service.routes import (
    alarms,
    asked,
    audit,
    calibrations,
    console,
    events,
    fixed_pairs,
    health,
    inspections,
    jobs,
    keys,
    login,
    phantoms,
    reconstructions,
    scanners,
    scans,
    schedules,
    uploads,
    volumes,
    webhooks,
)
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Stopping
from sawmill_store.store import Store
from sawmill_vocabulary.version import VERSION

DESCRIPTION = """\
Finds the geometry of a sawmill's X-ray log scanner from one scan of a wooden phantom, watches the scanner for drift,
and reconstructs logs with the geometry.

Long work answers **202** with `Location` and `Retry-After`; its job can be polled or streamed. Jobs wait for other jobs
that they need, so a scan can be uploaded and its calibration and reconstruction requested at once.
Errors are `application/problem+json` (RFC 9457) with a stable `code`. Names contain units.
"""
TAGS = [
    {"name": "scanners", "description": "Known constants, search bounds, tolerances, the active calibration, history."},
    {
        "name": "phantoms",
        "description": "Wooden bodies of known size: built in, drawn in mm, or traced from a picture.",
    },
    {
        "name": "uploads",
        "description": "Files that arrive in parts; an upload can be resumed after a broken connection.",
    },
    {"name": "scans", "description": "Projection stacks, uploaded as files and read by a job."},
    *({"name": declared.kind.plural, "description": declared.about} for declared in asked_kinds() if declared.about),
    {"name": "jobs", "description": "All long work: state, queue, progress, cancelling."},
    {"name": "events", "description": "Stream of all events."},
    {"name": "schedules", "description": "Recalibration and drift checks at fixed times."},
    {"name": "webhooks", "description": "Events posted to URLs that the settings allow."},
    {"name": "webhook messages", "description": "Requests that the service sends to a webhook."},
    {"name": "retention", "description": "Rules for how long data are kept, and previews of them."},
    {"name": "keys", "description": "Keys with their scopes, and the audit."},
    {"name": "operation", "description": "Health and metrics, for operators of the service."},
]
ROUTERS = (
    *(scanners, phantoms, uploads, inspections, scans, calibrations, fixed_pairs, reconstructions, volumes),
    *(jobs, events, schedules, alarms, webhooks, retention, keys, audit, health, login, console),
)


def create_app(
    settings: ServiceSettings, store: Store, wake: Wake, *, exposed: bool = False, broker_url: str | None = None
) -> Application:
    """Create the service on one store.

    Parameters
    ----------
    settings
        Limits and names; the caller listens on its host and port.
    store
        Store of everything; already upgraded.
    wake
        Called with the id of each job after the transaction that queued the job; must not raise.
    exposed
        Whether the caller listens beyond loopback: then every request must bring a key, as behind a proxy.
    broker_url
        URL of the Redis that carries wake-ups; people may see whether it answers. None: there is none.

    Returns
    -------
    Application
        An ASGI application.

    Raises
    ------
    ValueError
        A route declares no scope.
    """
    app = Application(
        title="Sawmill calibration",
        version=VERSION,
        description=DESCRIPTION,
        openapi_tags=TAGS,
        contact={"name": "The contributors to sawmill calibration"},
        license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
        servers=[{"url": "/"}],
        webhooks=webhooks.messages,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        # A redirect would name the address that the service sees, which is wrong behind a proxy.
        redirect_slashes=False,
    )
    app.state.settings, app.state.store, app.state.wake = settings, store, wake
    app.state.broker_url = broker_url
    app.state.session_cookie = SessionCookie(settings.public_url)
    app.state.access = Access(
        store.keys,
        store.sessions,
        app.state.session_cookie,
        token=settings.token,
        required=exposed or settings.behind_proxy,
        failures=FailedLogins(settings.failed_login_rate_limit),
    )
    registry = CollectorRegistry()
    registry.register(Measures(store))
    app.state.metrics = registry
    app.state.stopping = Stopping()
    app.state.digests = Digests()
    app.state.transfers = Transfers()
    app.state.memory_budget = MemoryBudget(settings.drawing_memory_bytes)
    app.state.stream_times = StreamTimes()
    app.state.event_feed = EventFeed(store.events, settings.event_poll_s)
    app.state.job_ends = JobEnds(app.state.event_feed, app.state.stopping, settings.event_poll_s)
    install(app)
    install_repeats(app)
    app.router.routes.extend(_all_routes())
    app.mount("/static", console.WholeFiles(directory=console.STATIC))
    app.mount("/console", console.WholeFiles(directory=Path(fastapi_offline.__file__).parent / "static"))
    app.state.rules = RouteRules(app.routes)
    # The middleware added last is the outermost.
    app.add_middleware(Heads)
    app.add_middleware(
        SlowBodies,
        silence_s=settings.client_silence_s,
        grace_s=settings.body_grace_s,
        least_bytes_per_s=settings.min_client_bytes_per_s,
    )
    app.add_middleware(Admission, settings=settings)
    app.add_middleware(
        Gate,
        settings=settings,
        access=app.state.access,
        open_files=login.FILES,
        refusals=Rates(settings.rate_limit),
        stopping=app.state.stopping,
    )
    if settings.trusted_proxies:
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=settings.trusted_proxies)
    app.add_middleware(Observer, registry=app.state.metrics)
    app.add_middleware(ProblemPages)
    app.add_middleware(ProtectiveHeaders)
    app.add_middleware(RequestIds)
    return app


@cache
def _all_routes() -> list[BaseRoute]:
    """Build the routes once for all applications of this process: FastAPI needs half a second to build them."""
    every = APIRouter(
        generate_unique_id_function=lambda route: route.name,
        dependencies=[Depends(check) for check in (check_method, check_scope, check_csrf, check_query, check_body)],
    )
    for router in (*map(asked.router_of, asked_kinds()), *(routes.router for routes in ROUTERS), *PAGES):
        every.include_router(router)
    return every.routes
