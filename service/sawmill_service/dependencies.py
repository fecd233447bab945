"""Dependencies that FastAPI passes to routes: the store, the settings, the wake-up and other parts.

Each dependency is a coroutine: FastAPI runs every other function in a separate thread, and the request waits for it.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated

from fastapi import Depends, Request

from sawmill_platform.database.database import after_commit
from sawmill_service.access import Access, Caller, caller_of
from sawmill_service.event_feed import EventFeed, StreamTimes
from sawmill_service.http.limits.transfers import Transfers
from sawmill_service.http.session_cookie import SessionCookie
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Stopping
from sawmill_store.store import Store

Wake = Callable[[str], None]


async def _store(request: Request) -> Store:
    store: Store = request.app.state.store
    return store


async def _settings(request: Request) -> ServiceSettings:
    settings: ServiceSettings = request.app.state.settings
    return settings


async def _wake(request: Request) -> Wake:
    wake: Wake = request.app.state.wake

    def note_and_wake(job_id: str) -> None:
        request.state.job_id = job_id  # for the request's line in the log
        after_commit(partial(wake, job_id))

    return note_and_wake


async def _stopping(request: Request) -> Stopping:
    stopping: Stopping = request.app.state.stopping
    return stopping


async def _access(request: Request) -> Access:
    access: Access = request.app.state.access
    return access


async def _session_cookie(request: Request) -> SessionCookie:
    cookie: SessionCookie = request.app.state.session_cookie
    return cookie


async def _event_feed(request: Request) -> EventFeed:
    feed: EventFeed = request.app.state.event_feed
    return feed


async def _stream_times(request: Request) -> StreamTimes:
    times: StreamTimes = request.app.state.stream_times
    return times


async def _transfers(request: Request) -> Transfers:
    transfers: Transfers = request.app.state.transfers
    return transfers


async def _caller(request: Request) -> Caller:
    return caller_of(request)


TheStore = Annotated[Store, Depends(_store)]
TheSettings = Annotated[ServiceSettings, Depends(_settings)]
TheWake = Annotated[Wake, Depends(_wake)]
TheStopping = Annotated[Stopping, Depends(_stopping)]
TheAccess = Annotated[Access, Depends(_access)]
TheSessionCookie = Annotated[SessionCookie, Depends(_session_cookie)]
TheEventFeed = Annotated[EventFeed, Depends(_event_feed)]
TheStreamTimes = Annotated[StreamTimes, Depends(_stream_times)]
TheTransfers = Annotated[Transfers, Depends(_transfers)]
TheCaller = Annotated[Caller, Depends(_caller)]
