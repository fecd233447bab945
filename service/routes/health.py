"""/health and /metrics."""

from enum import StrEnum

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import generate_latest
from pydantic import Field

from service.dependencies import TheStore
from worker.contracts.base import Contract
from worker.contracts.jobs import JobState

PATIENCE_S = 30.0  # several times what an idle worker needs to take a job

router = APIRouter(tags=["operation"])


class Readiness(StrEnum):
    """Whether requests can be answered, and whether jobs are being done."""

    READY = "ready"
    WITHOUT_WORKER = "without-worker"


class Health(Contract):
    """How the service is."""

    state: Readiness
    detail: str = Field(description="What is wrong, in one sentence; empty when nothing is.")


@router.get("/health/live", summary="Is the process alive", response_class=PlainTextResponse)
async def live() -> str:
    """Answers as long as the process does, whatever the threads are waiting for."""
    return "alive"


@router.get("/health/ready", summary="Can requests be answered")
def ready(store: TheStore) -> Health:
    """503 when the database or the data folder cannot be used.

    Jobs that wait while no worker runs any are told as `without-worker`: requests are still answered.
    """
    store.check()
    waiting = store.jobs.queued_job_ids(older_than_s=PATIENCE_S)
    if waiting and not store.jobs.counts()[JobState.RUNNING]:
        detail = f"{len(waiting)} jobs have waited for more than {PATIENCE_S:.0f} s and no worker runs any: start one"
        return Health(state=Readiness.WITHOUT_WORKER, detail=detail)
    return Health(state=Readiness.READY, detail="")


@router.get("/metrics", summary="Metrics for Prometheus", response_class=PlainTextResponse)
def metrics(request: Request) -> Response:
    """Jobs by state; requests and their seconds by route."""
    return PlainTextResponse(generate_latest(request.app.state.metrics), media_type="text/plain; version=0.0.4")
