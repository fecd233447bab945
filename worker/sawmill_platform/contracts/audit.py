"""The audit: who decided what, in rows that nothing changes or removes."""

from typing import Any

from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventType


class AuditEntry(Contract):
    """An action of a person or a program."""

    number: int = Field(description="Number of the entry; it grows from entry to entry.", examples=[41])
    at: Time = Field()
    who: str = Field(
        description="Name of the key; `schedule` and its id, or `the service` where no person acted.",
        examples=["software of line 2"],
    )
    key_id: Identifier | None = Field(
        description="Id of the key that the request carried. Null: the request carried none.",
        examples=["0f8b4c6d0d8a4b0e"],
    )
    address: str | None = Field(
        description="Network address of the client; null: there was no request.", examples=["192.168.1.20"]
    )
    request_id: str | None = Field(
        description="The `X-Request-Id` of the request, as in its answer and in the log. Null: there was no request.",
        examples=["0f8b4c6d0d8a4b0e9d0c5b8f3f1e2a77"],
    )
    action: EventType = Field(description="Action.", examples=["key-created"])
    subject_id: str = Field(description="Id of the object of the action.", examples=["example"])
    detail: dict[str, Any] | None = Field(
        description="The object's properties and the reason, where known.", examples=[{"reason": "checked by hand"}]
    )
