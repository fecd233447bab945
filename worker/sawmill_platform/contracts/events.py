"""What happened, and when: to scanners and what belongs to them, to jobs and attempts at them, and to the clock."""

from typing import Any

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventKind


class Event(Contract):
    """One thing that happened."""

    number: int = Field(
        description="Number of the event; it grows from event to event, not always by 1.", examples=[42]
    )
    at: Time = Field(examples=["2026-03-02T05:31:04Z"])
    what: EventKind = Field(
        description="`queued` to `cancelled` are of the job `job_id`. `lost`: the attempt ended unanswered; `put-off`: "
        "an outage ended it, which is no loss; `given-back`: its worker stopped or another job went first; "
        "`cancel-requested`: its worker was asked to stop; "
        "`schedule-missed`: a due time passed and nothing was queued, once until the schedule runs again; "
        "`alarm-opened`, `alarm-closed`: of a scanner, which `/v1/alarms` lists between the two; `webhook-paused`: "
        "nothing is sent to it any more, for `reason`; `retention-removed`: some of what `subject_id` names, as "
        "`log-scans`, went by the rules of "
        "`/v1/retention`; `clock-off`: the worker's clock differs from the "
        "service's by more than 5 s; `clock-stepped`: the service took over a lasting step of its machine's clock; "
        "`restored`: what is stored is of a backup, and what happened since then is not in it.",
        examples=["succeeded"],
    )
    scanner_id: Identifier | None = Field(
        None, description="The scanner that it concerns, where there is one.", examples=["example"]
    )
    subject: str | None = Field(
        None,
        description="What `subject_id` names: `scanner`, `scan`, `phantom`, `calibration`, `reconstruction`, `plan`, "
        "`drift`, `inspection`, `schedule`, `upload`, `key`, `webhook` or `retention`.",
        examples=["calibration"],
    )
    subject_id: Identifier | None = Field(
        None,
        description="What it happened to; of a job, what the job works on. Null in events of earlier versions.",
        examples=["example"],
    )
    job_id: Identifier | None = Field(
        None, description="Id of the job that it concerns. Null: none.", examples=["example"]
    )
    attempt: int | None = Field(
        None, description="Number of the attempt at the job. Null: it is of no attempt.", examples=[1]
    )
    worker: str | None = Field(None, description="Host and process.", examples=["mill:71"])
    detail: dict[str, Any] | None = Field(
        None,
        description="As the failure of an attempt and, where its process could tell, `peak_memory_bytes`; "
        "`reason` of an activation, a refusal, "
        "a paused webhook or a missed due time, which is `due_at`; `used_by`, the address of what was made of an "
        "upload, or the `reason` of its end; an alarm as `/v1/alarms` has it; the name of a backup and when it was "
        "taken; `number`, `freed_bytes`, `first_at` and `last_at` of what went by rules of retention; or seconds of "
        "the clock.",
        examples=[{"reason": "checked by hand"}],
    )


class JobHistory(Contract):
    """Each attempt at a job and its fate."""

    events: list[Event] = Field(description="The oldest first.")
