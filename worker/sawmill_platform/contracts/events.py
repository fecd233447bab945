"""Events and their times: of groups and what belongs to them, of jobs and attempts at them, and of the clock."""

from typing import Any

from pydantic import ConfigDict, Field

from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_vocabulary.messages import GROUP


class Event(Contract):
    """An event."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    number: int = Field(
        description="Number of the event; it grows from event to event, not always by 1.", examples=[42]
    )
    at: Time = Field(examples=["2026-03-02T05:31:04Z"])
    type: EventType = Field(examples=["succeeded"])
    group_id: Identifier | None = Field(
        None, alias=f"{GROUP}_id", description=f"Id of the {GROUP} that the event concerns. Null: none."
    )
    subject: str | None = Field(
        None,
        description="Type of `subject_id`: singular of its address, as `upload` of `/v1/uploads`.",
        examples=["upload"],
    )
    subject_id: Identifier | None = Field(
        None,
        description="Id of the object of the event; for a job, of what the job works on. Null in events of earlier "
        "versions.",
    )
    job_id: Identifier | None = Field(None, description="Id of the job that the event concerns. Null: none.")
    attempt: int | None = Field(
        None, description="Number of the attempt at the job. Null: the event concerns no attempt.", examples=[1]
    )
    worker: str | None = Field(
        None, description="Host and process of the worker. Null: the event concerns no worker.", examples=["host:71"]
    )
    detail: dict[str, Any] | None = Field(
        None,
        description="Details by kind of event: the failure of an attempt and, where its process could report it, "
        "`peak_memory_bytes`; `reason` of a decision, a refusal or a paused webhook; `used_by`, the address of what "
        "was made from an upload, or the `reason` of its end; the name of a backup and when it was taken; `number`, "
        "`first_at` and `last_at` of what rules of retention removed; seconds of the clock; or what "
        "follows from a result. The description of `what` has further ones.",
        examples=[{"reason": "checked by hand"}],
    )


class JobHistory(Contract):
    """The attempts at a job and their results."""

    events: list[Event] = Field(description="Events, the oldest first.")
