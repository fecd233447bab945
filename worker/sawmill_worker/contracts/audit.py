"""The audit: who decided what, in rows that nothing changes or removes."""

from enum import StrEnum
from typing import Any

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Time


class AuditAction(StrEnum):
    """What somebody did."""

    CALIBRATION_ACTIVATED = "calibration-activated"
    CALIBRATION_ROLLED_BACK = "calibration-rolled-back"
    SCANNER_CREATED = "scanner-created"
    SCANNER_CHANGED = "scanner-changed"
    SCANNER_DELETED = "scanner-deleted"
    PHANTOM_DELETED = "phantom-deleted"
    SCAN_DELETED = "scan-deleted"
    INSPECTION_DELETED = "inspection-deleted"
    SCHEDULE_CREATED = "schedule-created"
    SCHEDULE_CHANGED = "schedule-changed"
    SCHEDULE_DELETED = "schedule-deleted"
    JOB_CANCELLED = "job-cancelled"
    KEY_CREATED = "key-created"
    KEY_ROTATED = "key-rotated"
    KEY_REVOKED = "key-revoked"
    LOGGED_IN = "logged-in"
    LOGGED_OUT = "logged-out"


class AuditEntry(Contract):
    """One thing that somebody did."""

    number: int = Field(description="Grows from entry to entry.")
    at: Time
    who: str = Field(description="The name of the key; `the service` where a schedule or a job did it.")
    key_id: Identifier | None = Field(description="Null: without a key.")
    address: str | None = Field(description="From which the request came; null: it was no request.")
    request_id: str | None = Field(description="As in the answer's `X-Request-Id` and in the log.")
    action: AuditAction
    subject_id: str = Field(description="What it was done to.")
    detail: dict[str, Any] | None = Field(description="What the subject was, and why, where something is known.")
