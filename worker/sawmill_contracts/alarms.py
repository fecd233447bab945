"""Alarms: what should have come from a scanner by now and has not, and logs that show that it moved."""

from datetime import date
from enum import StrEnum

from pydantic import Field

from sawmill_contracts.scanner_drift import DriftFinding
from sawmill_platform.contracts.base import Contract, Identifier, Time


class AlarmKind(StrEnum):
    """What is missing, or was seen."""

    NO_PHANTOM_SCAN = "no-phantom-scan"
    PHANTOM_EXPIRED = "phantom-expired"
    SCANNER_QUIET = "scanner-quiet"
    DRIFT = "drift"


class Alarm(Contract):
    """Something that a scanner waits for; it is closed by itself when that has come."""

    scanner_id: Identifier = Field(description="Id of the scanner.", examples=["example"])
    what: AlarmKind = Field(
        description="`no-phantom-scan`: none since `last_at`, for longer than `limit_hours`. `scanner-quiet`: no scan "
        "at all for longer than that. `phantom-expired`: the phantom of the newest phantom scan was to be measured "
        "again by `expired_on`. `drift`: logs together show a jump or a trend, and no calibration was activated since.",
        examples=["no-phantom-scan"],
    )
    since: Time = Field(
        description="When the limit was passed, RFC 3339, UTC; a day ends at midnight UTC. Of a drift when the log was "
        "looked at that showed it.",
        examples=["2026-03-16T05:30:00Z"],
    )
    last_at: Time | None = Field(
        None,
        description="When the last one came that is known or, if none is, the scanner was added. Null: it is of a "
        "phantom or a drift.",
        examples=["2026-03-02T05:30:00Z"],
    )
    limit_hours: float | None = Field(
        None,
        description="The scanner's limit, a number of hours. Null: it is of a phantom or a drift.",
        examples=[336.0],
    )
    phantom_id: Identifier | None = Field(
        None, description="Id of the phantom that was to be measured again. Null: it is of no phantom.", examples=[None]
    )
    expired_on: date | None = Field(
        None, description="The last day of its measurement. Null: it is of no phantom.", examples=[None]
    )

    drift: DriftFinding | None = Field(
        None, description="What the logs showed when it was opened. Null: it is of no drift."
    )


class AlarmList(Contract):
    """The alarms that are open."""

    alarms: list[Alarm] = Field(description="By scanner; those that were closed are among the events.")
