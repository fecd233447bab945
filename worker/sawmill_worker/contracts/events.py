"""What happened, and when: to attempts at jobs, and to the clock."""

from enum import StrEnum
from typing import Any

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Time


class EventKind(StrEnum):
    """What happened."""

    STARTED = "started"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    LOST = "lost"
    PUT_OFF = "put-off"
    GIVEN_BACK = "given-back"
    CANCELLED = "cancelled"
    CLOCK_STEPPED = "clock-stepped"
    CLOCK_OFF = "clock-off"


class Event(Contract):
    """One thing that happened."""

    number: int = Field(description="Grows from event to event.")
    at: Time
    what: EventKind = Field(
        description="`lost`: the attempt ended unanswered; `put-off`: an outage ended it, which is no loss; "
        "`given-back`: its worker stopped or another job went first; `clock-off`: the worker's clock differs from the "
        "service's by more than 5 s; `clock-stepped`: the service took over a lasting step of its machine's clock."
    )
    job_id: Identifier | None = None
    attempt: int | None = None
    worker: str | None = Field(None, description="Host and process.")
    detail: dict[str, Any] | None = Field(
        None,
        description="As the failure of an attempt and, where its process could tell, `peak_memory_bytes`; or seconds "
        "of the clock.",
    )


class JobHistory(Contract):
    """Each attempt at a job and its fate."""

    events: list[Event] = Field(description="The oldest first.")
