"""Alarms of a scanner: overdue scans or measurements, and drift."""

from datetime import date
from enum import StrEnum

from pydantic import Field

from sawmill_contracts.next_steps import Acknowledgement
from sawmill_contracts.scanner_drift import DriftFinding
from sawmill_platform.contracts.base import Contract, Identifier, Time


class AlarmKind(StrEnum):
    """Kind of an alarm."""

    NO_PHANTOM_SCAN = "no-phantom-scan"
    PHANTOM_EXPIRED = "phantom-expired"
    SCANNER_QUIET = "scanner-quiet"
    DRIFT = "drift"


class Alarm(Contract):
    """An overdue scan or measurement, or a drift of a scanner; the alarm closes by itself when its cause has gone."""

    scanner_id: Identifier = Field(description="Id of the scanner.")
    kind: AlarmKind = Field(
        description="`no-phantom-scan`: no phantom scan since `last_at`, for longer than `limit_hours`. "
        "`scanner-quiet`: no scan of any kind for longer than `limit_hours`. `phantom-expired`: the phantom of the "
        "newest phantom scan was due for a new measurement by `expired_on`. `drift`: the scanner's logs together "
        "show a jump or a trend, and no calibration was activated since.",
        examples=["no-phantom-scan"],
    )
    since: Time = Field(
        description="Time at which the limit was passed, RFC 3339, UTC; a day ends at midnight UTC. An "
        "alarm of drift has the time of the drift check that showed it.",
        examples=["2026-03-16T05:30:00Z"],
    )
    last_at: Time | None = Field(
        None,
        description="Time of the last known scan of this kind or, if there is none, of the scanner's registration. "
        "Null: the alarm concerns a phantom or a drift.",
    )
    limit_hours: float | None = Field(
        None,
        description="The scanner's limit, number of hours. Null: the alarm concerns a phantom or a drift.",
        examples=[336.0],
    )
    phantom_id: Identifier | None = Field(
        None,
        description="Id of the phantom that is due for a new measurement. Null: the alarm concerns no phantom.",
        examples=[None],
    )
    expired_on: date | None = Field(
        None,
        description="Last day on which the phantom's measurement was valid. Null: the alarm concerns no phantom.",
        examples=[None],
    )

    drift: DriftFinding | None = Field(
        None, description="Finding from the logs when the alarm was opened. Null: the alarm concerns no drift."
    )
    acknowledged: Acknowledgement | None = Field(
        None, description="The last acknowledgement, which may have ended. Null: nobody acknowledged the alarm."
    )
