"""Events and their times: of groups and what belongs to them, of jobs and attempts at them, and of the clock."""

from typing import Any

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventKind


class Event(Contract):
    """An event."""

    number: int = Field(
        description="Number of the event; it grows from event to event, not always by 1.", examples=[42]
    )
    at: Time = Field(examples=["2026-03-02T05:31:04Z"])
    what: EventKind = Field(
        description="`queued` to `cancelled` concern the job `job_id`. `lost`: the attempt ended without an answer; "
        "`put-off`: an outage ended the attempt, which is no loss; `given-back`: its worker stopped or another job "
        "went first; `cancel-requested`: its worker was requested to stop; `schedule-missed`: a due time passed and "
        "nothing was queued, reported once until the schedule runs again; `alarm-opened`, `alarm-closed`: an alarm "
        "of a scanner, which `/v1/alarms` lists between the two; `webhook-paused`: nothing is sent to the webhook "
        "any more, for `reason`; `retention-removed`: rows or files of the kind that `subject_id` names, as "
        "`log-scans`, were removed by the rules of `/v1/retention`; `clock-off`: the worker's clock differs from "
        "the service's by more than 5 s; `clock-stepped`: the service followed a lasting step of its machine's "
        "clock; `restored`: the database was restored from a backup and lacks what happened after that backup.",
        examples=["succeeded"],
    )
    scanner_id: Identifier | None = Field(
        None, description="Id of the scanner that the event concerns. Null: none.", examples=["example"]
    )
    subject: str | None = Field(
        None,
        description="Type of `subject_id`: `scanner`, `scan`, `phantom`, `calibration`, `reconstruction`, `plan`, "
        "`drift`, `inspection`, `schedule`, `upload`, `key`, `webhook` or `retention`.",
        examples=["calibration"],
    )
    subject_id: Identifier | None = Field(
        None,
        description="Id of the object of the event; for a job, of what the job works on. Null in events of earlier "
        "versions.",
        examples=["example"],
    )
    job_id: Identifier | None = Field(
        None, description="Id of the job that the event concerns. Null: none.", examples=["example"]
    )
    attempt: int | None = Field(
        None, description="Number of the attempt at the job. Null: the event concerns no attempt.", examples=[1]
    )
    worker: str | None = Field(
        None, description="Host and process of the worker. Null: the event concerns no worker.", examples=["mill:71"]
    )
    detail: dict[str, Any] | None = Field(
        None,
        description="Details by kind of event: the failure of an attempt and, where its process could report it, "
        "`peak_memory_bytes`; `reason` of an activation, a refusal, a paused webhook or a missed due time, which is "
        "`due_at`; `used_by`, the address of what was made from an upload, or the `reason` of its end; an alarm as "
        "in `/v1/alarms`; the name of a backup and when it was taken; `number`, `freed_bytes`, `first_at` and "
        "`last_at` of what rules of retention removed; or seconds of the clock.",
        examples=[{"reason": "checked by hand"}],
    )


class JobHistory(Contract):
    """The attempts at a job and their results."""

    events: list[Event] = Field(description="Events, the oldest first.")
