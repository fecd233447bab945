"""/v1/jobs."""

import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent

from sawmill_service.answers import Paging, accept
from sawmill_service.dependencies import TheSettings, TheStopping, TheStore
from sawmill_service.described_answers import events
from sawmill_service.refusals import refuses
from sawmill_service.repeats import repeatable
from sawmill_service.waiting import TheWaiting
from sawmill_worker.contracts.base import Identifier, Page
from sawmill_worker.contracts.events import JobHistory
from sawmill_worker.contracts.jobs import Job, JobKind, JobState
from sawmill_worker.storage.errors import Conflict, StorageUnavailable
from sawmill_worker.storage.store import Store

SHORTEST_PAUSE_S = 0.02

EXAMPLE = """\
event: job
data: {"id": "example", "kind": "calibrate", "state": "running", "progress": {"fraction": 0.4, "stage": "search"}}
id: 0

event: end
data: "succeeded"
id: 1

"""
_JOB, _STATE = ({"$ref": f"#/components/schemas/{name}"} for name in ("Job", "JobState"))
DESCRIBED = events(
    "Server-sent events: `job` with the job as JSON at every change, then `end` with its final state; `closing` "
    "with its state when the service stops before that.",
    EXAMPLE,
    {"job": _JOB, "end": _STATE, "closing": _STATE},
)

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


class JobFilter(Paging):
    """Which jobs to list."""

    kind: JobKind | None = None
    state: JobState | None = None


@router.get("", summary="List jobs, newest first", responses=refuses("invalid-cursor"))
def list_jobs(query: Annotated[JobFilter, Query()], store: TheStore) -> Page[Job]:
    """All of them, or those of one kind, or in one state."""
    return store.jobs.page(kind=query.kind, state=query.state, after=query.after, limit=query.limit)


def _job(job_id: Identifier, store: TheStore) -> Job:
    return store.jobs.get(job_id)


TheJob = Annotated[Job, Depends(_job)]


@router.get("/{job_id}", summary="Get a job", responses=refuses("job-not-found"))
async def get_job(job_id: Identifier, store: TheStore, waiting: TheWaiting) -> Job:
    """State, place in the queue, progress, and why it failed if it did; with `wait` as soon as it has ended."""
    return await waiting.read(lambda: store.jobs.get(job_id))


@router.get(
    "/{job_id}/events",
    response_class=EventSourceResponse,
    summary="Stream a job's progress",
    responses=DESCRIBED | refuses("job-not-found"),
)
async def stream_job(
    job: TheJob, store: TheStore, settings: TheSettings, stopping: TheStopping
) -> AsyncIterator[ServerSentEvent]:
    """The job now and at each change; after the event `end` the client closes the stream.

    When the service stops, the last event is `closing`: the client connects again, after the time in `retry`.
    """
    started, number = time.monotonic(), 0
    yield ServerSentEvent(data=job, event="job", id=str(number))
    while not job.state.ended:
        await stopping.sleep(_pause_s(time.monotonic() - started, settings.event_poll_s))
        if stopping.begun:
            retry_ms = 1000 * settings.retry_after_s
            yield ServerSentEvent(data=job.state, event="closing", id=str(number), retry=retry_ms)
            return
        now = await run_in_threadpool(_now, store, job)
        if _tells_more(now, job):
            job, number = now, number + 1
            yield ServerSentEvent(data=job, event="job", id=str(number))
    yield ServerSentEvent(data=job.state, event="end", id=str(number + 1))


def _now(store: Store, job: Job) -> Job:
    """The job as it stands, or as it stood while the database does not answer: a stream outlives that."""
    try:
        return store.jobs.get(job.id)
    except StorageUnavailable:
        return job


def _tells_more(now: Job, before: Job) -> bool:
    """Whether more has changed than the time left, which runs by itself."""
    return now.model_copy(update={"seconds_left": before.seconds_left}) != before


def _pause_s(waited_s: float, longest_s: float) -> float:
    """Until the next look at a job: a tenth of the wait so far, so that short jobs are not reported late."""
    return min(longest_s, max(SHORTEST_PAUSE_S, 0.1 * waited_s))


@router.get("/{job_id}/history", summary="Each attempt at a job and its fate", responses=refuses("job-not-found"))
def job_history(job_id: Identifier, store: TheStore) -> JobHistory:
    """When each attempt started, on which worker, and how it ended: `lost`, `put-off`, `given-back` or for good."""
    return JobHistory(events=store.events.of_job(job_id))


@router.post("/{job_id}/cancel", status_code=202, summary="Cancel a job", responses=refuses("job-not-found"))
@repeatable
def cancel_job(job_id: Identifier, store: TheStore, settings: TheSettings, response: Response) -> Job:
    """A queued job ends at once, a running one within seconds; an ended one is answered as it is."""
    try:
        job = store.jobs.request_cancel(job_id)
    except Conflict:  # it has ended, perhaps a moment ago: that is what the caller wanted
        job = store.jobs.get(job_id)
    accept(response, f"/v1/jobs/{job.id}", settings.retry_after_s)
    return job
