"""/v1/jobs."""

import time
from collections.abc import AsyncIterator
from http import HTTPStatus
from typing import Annotated, NamedTuple

from fastapi import Depends, Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent

from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.events import JobHistory
from sawmill_platform.contracts.jobs import Job, JobKind, JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, StorageUnavailable
from sawmill_platform.ledger.events import JobNumbers
from sawmill_service.dependencies import TheSettings, TheStopping, TheStore
from sawmill_service.event_feed import LastEventId
from sawmill_service.http.document.described_answers import events, refuses
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import Paging, accept
from sawmill_service.http.responses.waiting import TheWaiting
from sawmill_service.http.route_rules import Router
from sawmill_store.store import Store

SHORTEST_PAUSE_S = 0.02

EXAMPLE = """\
event: job
data: {"id": "example", "kind": "calibrate", "state": "running", "progress": {"fraction": 0.4, "stage": "search"}}
id: 41
retry: 1000

event: job
data: {"id": "example", "kind": "calibrate", "state": "succeeded", "progress": null}
id: 41

event: end
data: "succeeded"
id: 42

"""
_JOB, _STATE = ({"$ref": f"#/components/schemas/{name}"} for name in ("Job", "JobState"))
DESCRIBED = events(
    "Server-sent events: `job` with the job as JSON, as it is and at every change, then `end` with "
    "its final state; `closing` with its state when the service stops earlier. The id of `end` is the number of "
    "the event in `/v1/events` that ended the job, other ids are the number of the newest earlier event.",
    EXAMPLE,
    {"job": _JOB, "end": _STATE, "closing": _STATE},
) | {204: {"description": "`Last-Event-ID` is the id of `end`: nothing follows, and browsers connect no more."}}

router = Router(prefix="/v1/jobs", tags=["jobs"], reading=Scope.READ)


class JobFilter(Paging):
    """Filter of the jobs to list."""

    kind: JobKind | None = None
    state: JobState | None = None


@router.get("", summary="List jobs, newest first", responses=refuses("invalid-cursor"))
def list_jobs(query: Annotated[JobFilter, Query()], store: TheStore) -> Page[Job]:
    """List all jobs, or a selection by kind and state."""
    return store.jobs.page(kind=query.kind, state=query.state, after=query.after, limit=query.limit)


@router.get("/{job_id}", summary="Get a job", responses=refuses("job-not-found"))
async def get_job(job_id: Identifier, store: TheStore, waiting: TheWaiting) -> Job:
    """Return state, place in the queue, progress, and the reason of a failure; with `wait` when the job has ended."""
    return await waiting.read(lambda: store.jobs.get(job_id))


class JobNow(NamedTuple):
    """A job with the numbers of the job's events, which were read before the job."""

    job: Job
    numbers: JobNumbers


def _to_follow(
    job_id: Identifier, store: TheStore, response: Response, last_event_id: LastEventId = None
) -> JobNow | None:
    """Return the job with which a stream begins; None if the client has seen the end."""
    now = _read(store, job_id)
    if last_event_id is None or last_event_id != now.numbers.end:
        return now
    response.status_code = HTTPStatus.NO_CONTENT
    return None


@router.get(
    "/{job_id}/events",
    response_class=EventSourceResponse,
    summary="Stream a job's progress",
    responses=DESCRIBED | refuses("job-not-found"),
)
async def stream_job(
    now: Annotated[JobNow | None, Depends(_to_follow)], store: TheStore, settings: TheSettings, stopping: TheStopping
) -> AsyncIterator[ServerSentEvent]:
    """Stream the job now and at each change; after the event `end` the client closes the stream.

    After any `Last-Event-ID` but the id of `end` the stream starts with the present state of the job.
    When the service stops, the last event is `closing`: the client connects again, after the time in `retry`. Ids are
    stored numbers, so they remain valid beyond a stream and a service.
    """
    if now is None:
        return
    started, retry_ms = time.monotonic(), 1000 * settings.retry_after_s
    yield _event("job", now, retry_ms)
    while not now.job.state.ended:
        # A tenth of the wait so far, so that short jobs are reported soon.
        await stopping.sleep(min(settings.event_poll_s, max(SHORTEST_PAUSE_S, 0.1 * (time.monotonic() - started))))
        if stopping.begun:
            yield _event("closing", now, retry_ms)
            return
        before, now = now, await run_in_threadpool(_read_or_keep, store, now)
        # The time left changes by itself.
        if now.job.model_copy(update={"seconds_left": before.job.seconds_left}) != before.job:
            yield _event("job", now)
    yield ServerSentEvent(data=now.job.state, event="end", id=None if now.numbers.end is None else str(now.numbers.end))


def _event(name: str, now: JobNow, retry_ms: int | None = None) -> ServerSentEvent:
    data = now.job if name == "job" else now.job.state
    return ServerSentEvent(data=data, event=name, id=str(now.numbers.latest), retry=retry_ms)


def _read(store: Store, job_id: str) -> JobNow:
    numbers = store.events.numbers_of_job(job_id)
    job = store.jobs.get(job_id)
    if job.state.ended and numbers.end is None:  # between the two reads
        numbers = store.events.numbers_of_job(job_id)
    return JobNow(job, numbers)


def _read_or_keep(store: Store, before: JobNow) -> JobNow:
    """Read the job, or return it as it was before if the database does not answer, which a stream outlives."""
    try:
        return _read(store, before.job.id)
    except StorageUnavailable:
        return before


@router.get("/{job_id}/history", summary="List the attempts at a job", responses=refuses("job-not-found"))
def get_job_history(job_id: Identifier, store: TheStore) -> JobHistory:
    """List each attempt with its start, its worker, and its end: `lost`, `postponed`, `given-back` or for good."""
    return JobHistory(events=store.events.of_job(job_id))


@router.post(
    "/{job_id}/cancel", needs=Scope.SUBMIT, status_code=202, summary="Cancel a job", responses=refuses("job-not-found")
)
@repeatable
def cancel_job(job_id: Identifier, store: TheStore, settings: TheSettings, response: Response) -> Job:
    """Cancel a job: a queued job ends at once, a running one within seconds; an ended one is answered as it is."""
    try:
        job = store.jobs.request_cancel(job_id)
    except Conflict:  # the job has ended, perhaps a moment ago, as the caller wanted
        job = store.jobs.get(job_id)
    accept(response, f"/v1/jobs/{job.id}", settings.retry_after_s)
    return job
