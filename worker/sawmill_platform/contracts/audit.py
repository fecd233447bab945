"""The audit: who decided what, in rows that nothing changes or removes."""

from typing import Any

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventKind


class AuditEntry(Contract):
    """One thing that somebody did."""

    number: int = Field(description="Number of the entry; it grows from entry to entry.", examples=[41])
    at: Time = Field(examples=["2026-03-02T05:30:00Z"])
    who: str = Field(
        description="The name of the key; `schedule` and its id, or `the service` where no person did it.",
        examples=["scanner software of line 2"],
    )
    key_id: Identifier | None = Field(
        description="Id of the key that the request brought. Null: it brought none.", examples=["0f8b4c6d0d8a4b0e"]
    )
    address: str | None = Field(
        description="From which the request came; null: it was no request.", examples=["192.168.1.20"]
    )
    request_id: str | None = Field(
        description="The `X-Request-Id` of the request, as in its answer and in the log. Null: it was no request.",
        examples=["0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )
    action: EventKind = Field(description="What was done.", examples=["calibration-activated"])
    subject_id: str = Field(description="Id of what it was done to.", examples=["example"])
    detail: dict[str, Any] | None = Field(
        description="What the subject was, and why, where something is known.", examples=[{"reason": "checked by hand"}]
    )
