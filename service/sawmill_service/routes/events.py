"""/v1/events."""

import math
import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import Field

from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import StorageUnavailable
from sawmill_service.access import Access
from sawmill_service.dependencies import TheAccess, TheEventFeed, TheSettings, TheStopping, TheStreamTimes
from sawmill_service.event_feed import LARGEST_NUMBER, LastEventId
from sawmill_service.http.document.described_answers import events
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.route_rules import Router

EXAMPLE = """\
event: alive
data: {"number": 41}
id: 41
retry: 1000

event: succeeded
data: {"number": 42, "at": "2026-03-02T05:31:04Z", "type": "succeeded", "scanner_id": "example", \
"subject": "calibration", "subject_id": "example", "job_id": "example", "attempt": 1, "worker": "mill:71"}
id: 42

"""
_SEEN = {"type": "object", "properties": {"number": {"type": "integer"}}, "required": ["number"]}
_EVENT = {"$ref": "#/components/schemas/Event"}
DESCRIBED = events(
    "Server-sent events: each event of the service under its kind, as in `what`, with the `Event` "
    "as JSON and its number as the id; `alive` with the number up to which the client has seen all events; "
    "`closing` before the service ends the stream.",
    EXAMPLE,
    {"alive": _SEEN, "closing": _SEEN, **dict.fromkeys(EventType.published(), _EVENT)},
)

router = Router(prefix="/v1/events", tags=["events"], reading=Scope.READ)


class EventFilter(Given):
    """Selection of the events to send."""

    scanner_id: Identifier | None = Field(
        None, description="Id of the scanner whose events are sent. Default: all events."
    )
    after: Annotated[int, Field(ge=0, le=LARGEST_NUMBER)] | None = Field(
        None,
        description="Number of the last event that the client has seen, for clients that cannot send `Last-Event-ID`.",
        examples=[0],
    )
    duration_s: Annotated[float, Field(gt=0, le=86_400)] | None = Field(
        None, description="Seconds after which the stream ends. Default: it ends with the service.", examples=[0.5]
    )


@router.get(
    "",
    response_class=EventSourceResponse,
    summary="Follow what happens",
    responses=DESCRIBED,
    openapi_extra=trying(duration_s=0.5),
)
async def stream_events(
    request: Request,
    query: Annotated[EventFilter, Query()],
    feed: TheEventFeed,
    settings: TheSettings,
    stopping: TheStopping,
    access: TheAccess,
    times: TheStreamTimes,
    last_event_id: LastEventId = None,
) -> AsyncIterator[ServerSentEvent]:
    """Stream all changes: of jobs, what jobs work on, scanners, schedules, uploads and keys.

    Events since `Last-Event-ID` come first, each once; without that header the stream starts with the next event.
    `alive` comes at once and then after every five seconds without an event. While the database does not answer,
    comments come in place of events, and the stream continues afterwards. When the service stops, or the key or
    `duration_s` ends, the last event is `closing`: the client connects again, after the time in `retry`.
    """
    number = await feed.start(query.after if last_event_id is None else last_event_id)
    retry_ms = 1000 * settings.retry_after_s
    yield _alive(number, retry_ms)
    heard_at_s = checked_at_s = time.monotonic()
    ends_at_s = heard_at_s + (query.duration_s or math.inf)
    while not stopping.begun and time.monotonic() < ends_at_s:
        await stopping.sleep(settings.event_poll_s)
        now_s = time.monotonic()
        if now_s - checked_at_s > times.access_s:
            checked_at_s = now_s
            if not await _may_listen(request, access):
                break
        sign = _alive(number)
        try:
            number, followed = await feed.after(number, query.scanner_id)
        except StorageUnavailable:
            followed, sign = (), ServerSentEvent(comment="the database does not answer")
        for event in followed:
            heard_at_s = now_s
            yield ServerSentEvent(data=event, event=event.type, id=str(event.number))
        if now_s - heard_at_s > times.alive_s:
            heard_at_s = now_s
            yield sign
    yield ServerSentEvent(data={"number": number}, event="closing", id=str(number), retry=retry_ms)


def _alive(number: int, retry_ms: int | None = None) -> ServerSentEvent:
    return ServerSentEvent(data={"number": number}, event="alive", id=str(number), retry=retry_ms)


async def _may_listen(request: Request, access: Access) -> bool:
    """Return whether the stream's key or session is still valid; true if the database does not answer."""
    try:
        await access.caller(request.scope, request.headers)
    except Refused:
        return False
    except StorageUnavailable:
        return True
    return True
