"""Dependencies that FastAPI passes to routes: the store, the settings, the wake-up and others.

Each dependency is a coroutine: FastAPI runs every other function in a separate thread, and the request waits for it.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated

from fastapi import Depends, Request

from sawmill_platform.database.database import after_commit
from sawmill_service.access import Access, Caller, SessionCookie, caller_of
from sawmill_service.event_feed import EventFeed, StreamTimes
from sawmill_service.http.limits.transfers import Transfers
from sawmill_service.settings import ServiceSettings
from sawmill_service.stopping import Stopping
from sawmill_store.store import Store

Wake = Callable[[str], None]


def _of_app(name: str) -> object:
    """Return the dependency that gives an attribute of the application's state."""

    async def attribute(request: Request) -> object:
        return getattr(request.app.state, name)

    return Depends(attribute)


async def _wake(request: Request) -> Wake:
    wake: Wake = request.app.state.wake

    def note_and_wake(job_id: str) -> None:
        request.state.job_id = job_id  # for the request's line in the log
        after_commit(partial(wake, job_id))

    return note_and_wake


async def _caller(request: Request) -> Caller:
    return caller_of(request)


TheStore = Annotated[Store, _of_app("store")]
TheSettings = Annotated[ServiceSettings, _of_app("settings")]
TheWake = Annotated[Wake, Depends(_wake)]
TheStopping = Annotated[Stopping, _of_app("stopping")]
TheAccess = Annotated[Access, _of_app("access")]
TheSessionCookie = Annotated[SessionCookie, _of_app("session_cookie")]
TheEventFeed = Annotated[EventFeed, _of_app("event_feed")]
TheStreamTimes = Annotated[StreamTimes, _of_app("stream_times")]
TheTransfers = Annotated[Transfers, _of_app("transfers")]
TheCaller = Annotated[Caller, Depends(_caller)]
