"""/health and /metrics."""

from enum import StrEnum
from typing import TYPE_CHECKING

import structlog
from fastapi import Request, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import generate_latest
from pydantic import Field

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import FolderUnavailable, StorageFull, StorageUnavailable
from sawmill_service.dependencies import TheStore
from sawmill_service.http.problems import COME_BACK, MEDIA_TYPE
from sawmill_service.http.route_rules import NoKey, Router
from sawmill_store.store import Store

if TYPE_CHECKING:
    from sawmill_platform.workers.broker_report import BrokerReport

NOT_READY = "the database cannot be used now: the service's log has the reason"
PATIENCE_S = 30.0  # several times what an idle worker needs to take a job

log = structlog.get_logger(__name__)
router = Router(tags=["operation"], reading=Scope.READ)


class Readiness(StrEnum):
    """State of the service: whether requests are answered and jobs are run."""

    READY = "ready"
    WITHOUT_WORKER = "without-worker"
    DISK_FULL = "disk-full"


class Health(Contract):
    """Health of the service."""

    state: Readiness
    detail: str = Field(description="Fault, in one sentence; empty when there is none.", examples=[""])


@router.get("/health/live", needs=NoKey.MONITORING, summary="Is the process alive", response_class=PlainTextResponse)
async def get_liveness() -> str:
    """Answer as long as the process runs, whatever its threads wait for."""
    return "alive"


@router.get(
    "/health/ready",
    needs=NoKey.MONITORING,
    summary="Can requests be answered",
    responses={
        503: {
            "model": Health,
            "description": "`disk-full`; a problem where the database or the data folder cannot be used.",
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
        }
    },
)
def get_readiness(request: Request, store: TheStore, response: Response) -> Health:
    """Report 503 when database or data folder cannot be used, or when the disk is full or nearly so (`disk-full`).

    On a full disk results can still be read; uploads are refused, and jobs wait until there is room.
    Jobs that wait while no worker runs any are reported as `without-worker`, also where workers cannot use Redis:
    requests are still answered.
    """
    try:
        health = health_of(store, request.app.state.broker_url)
    except FolderUnavailable as error:
        log.warning("not-ready", reason=str(error))
        raise
    except StorageUnavailable as error:
        # No key is needed, and the database's own messages name hosts and users.
        log.warning("not-ready", reason=str(error))
        raise type(error)(NOT_READY) from error
    if health.state is Readiness.DISK_FULL:
        response.status_code = 503
        response.headers.update(COME_BACK)
    return health


def health_of(store: Store, broker_url: str | None = None) -> Health:
    """Return the health of the service or raise `StorageUnavailable`; a broker's URL adds whether Redis delays jobs."""
    try:
        store.check()
    except StorageFull as error:
        return Health(state=Readiness.DISK_FULL, detail=str(error))
    waiting = store.jobs.queued_job_ids(older_than_s=PATIENCE_S, limit=1)
    if waiting and not (counts := store.jobs.counts())[JobState.RUNNING]:
        broker = broker_of(broker_url)
        detail = (
            f"{counts[JobState.QUEUED]} jobs wait, one of them for more than {PATIENCE_S:.0f} s, and no worker runs "
            f"any: {(broker and broker.trouble) or 'start one'}"
        )
        return Health(state=Readiness.WITHOUT_WORKER, detail=detail)
    return Health(state=Readiness.READY, detail="")


def broker_of(broker_url: str | None) -> "BrokerReport | None":
    """Return the state of Redis; None if it is not used."""
    if broker_url is None:
        return None
    # Imported here: without a broker its client is not needed.
    from sawmill_platform.workers.broker_report import report_of  # noqa: PLC0415

    return report_of(broker_url)


@router.get("/metrics", summary="Metrics for Prometheus", response_class=PlainTextResponse)
def get_metrics(request: Request) -> Response:
    """Report jobs, attempts, memory, disk, requests, scanners' ray errors and movements: docs/look-up/metrics.md.

    The status is always 200: if the database does not answer, `sawmill_database_up` is 0 and its metrics are omitted.
    """
    return PlainTextResponse(generate_latest(request.app.state.metrics), media_type="text/plain; version=0.0.4")
