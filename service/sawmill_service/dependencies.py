"""Dependencies that FastAPI passes to routes: the store and its parts, the settings, the wake-up and others.

Each dependency is a coroutine: FastAPI runs every other function in a separate thread, and the request waits for it.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated

from fastapi import Depends, Request

from sawmill_platform.database.database import after_commit
from sawmill_platform.jobs.job_store import Jobs
from sawmill_platform.jobs.queue_limits import Places
from sawmill_platform.keys.key_store import KeyStore, Sessions
from sawmill_platform.keys.repeats import Repeats
from sawmill_platform.ledger.audit import Audit
from sawmill_platform.ledger.events import Events
from sawmill_platform.uploads.upload_store import Uploads
from sawmill_platform.webhooks.webhook_store import WebhookStore
from sawmill_service.access import Access, Caller, SessionCookie, caller_of
from sawmill_service.event_feed import EventFeed, StreamTimes
from sawmill_service.http.limits.transfers import Transfers
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Stopping
from sawmill_store.calibrations import Calibrations, Reconstructions
from sawmill_store.drift.drift_charts import DriftCharts
from sawmill_store.drift.measurements import Measurements
from sawmill_store.mill_files import MillFiles
from sawmill_store.retention.retention_store import RetentionStore
from sawmill_store.scanners.alarms import Alarms
from sawmill_store.scanners.history import Histories
from sawmill_store.scanners.scanners import Scanners
from sawmill_store.scans.phantoms import Phantoms
from sawmill_store.scans.scans import Inspections, Scans
from sawmill_store.schedules.schedules import Schedules
from sawmill_store.store import Plans, Store

Wake = Callable[[str], None]


def _of_app(name: str) -> object:
    """Return the dependency that gives an attribute of the application's state."""

    async def attribute(request: Request) -> object:
        return getattr(request.app.state, name)

    return Depends(attribute)


def part(select: Callable[[Store], object]) -> object:
    """Return the dependency that gives a part of the store."""

    async def of_store(request: Request) -> object:
        return select(request.app.state.store)

    return Depends(of_store)


async def _wake(request: Request) -> Wake:
    wake: Wake = request.app.state.wake

    def note_and_wake(job_id: str) -> None:
        request.state.job_id = job_id  # for the request's line in the log
        after_commit(partial(wake, job_id))

    return note_and_wake


async def _caller(request: Request) -> Caller:
    return caller_of(request)


TheStore = Annotated[Store, _of_app("store")]
TheAlarms = Annotated[Alarms, part(lambda store: store.alarms)]
TheAudit = Annotated[Audit, part(lambda store: store.audit)]
TheCalibrations = Annotated[Calibrations, part(lambda store: store.calibrations)]
TheDriftCharts = Annotated[DriftCharts, part(lambda store: store.drift_charts)]
TheEvents = Annotated[Events, part(lambda store: store.events)]
TheFiles = Annotated[MillFiles, part(lambda store: store.files)]
TheHistory = Annotated[Histories, part(lambda store: store.history)]
TheInspections = Annotated[Inspections, part(lambda store: store.inspections)]
TheJobs = Annotated[Jobs, part(lambda store: store.jobs)]
TheKeys = Annotated[KeyStore, part(lambda store: store.keys)]
TheMeasurements = Annotated[Measurements, part(lambda store: store.measurements)]
ThePhantoms = Annotated[Phantoms, part(lambda store: store.phantoms)]
ThePlaces = Annotated[Places, part(lambda store: store.places)]
ThePlans = Annotated[Plans, part(lambda store: store.plans)]
TheReconstructions = Annotated[Reconstructions, part(lambda store: store.reconstructions)]
TheRepeats = Annotated[Repeats, part(lambda store: store.repeats)]
TheRetention = Annotated[RetentionStore, part(lambda store: store.retention)]
TheScanners = Annotated[Scanners, part(lambda store: store.scanners)]
TheScans = Annotated[Scans, part(lambda store: store.scans)]
TheSchedules = Annotated[Schedules, part(lambda store: store.schedules)]
TheSessions = Annotated[Sessions, part(lambda store: store.sessions)]
TheUploads = Annotated[Uploads, part(lambda store: store.uploads)]
TheWebhooks = Annotated[WebhookStore, part(lambda store: store.webhooks)]
TheSettings = Annotated[ServiceSettings, _of_app("settings")]
TheWake = Annotated[Wake, Depends(_wake)]
TheStopping = Annotated[Stopping, _of_app("stopping")]
TheAccess = Annotated[Access, _of_app("access")]
TheSessionCookie = Annotated[SessionCookie, _of_app("session_cookie")]
TheEventFeed = Annotated[EventFeed, _of_app("event_feed")]
TheStreamTimes = Annotated[StreamTimes, _of_app("stream_times")]
TheTransfers = Annotated[Transfers, _of_app("transfers")]
TheCaller = Annotated[Caller, Depends(_caller)]
