"""A scanner's history: what happened, when, by whom and why, in rows that outlast their subjects."""

from datetime import datetime
from enum import StrEnum
from typing import NamedTuple, Self

from pydantic import Field

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.measurements import Measurement
from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventType


class HistoryKind(StrEnum):
    """Kind of an entry."""

    CALIBRATION = "calibration"
    DRIFT_CHECK = "drift-check"
    ACTIVATION = "activation"
    DISCARD = "discard"
    ALARM = "alarm"
    SETTINGS = "settings"
    SCHEDULE = "schedule"
    SCAN = "scan"


class HistoryEntry(Contract):
    """An entry of a scanner's history."""

    number: int = Field(description="Number of the entry.", examples=[12])
    at: Time = Field(description="Time of the entry; for a calibration or a drift check, when its job ended.")
    kind: HistoryKind = Field(
        description="`calibration`, `drift-check`: a job that ended. `activation`: a calibration became the active "
        "one. `discard`: a failed or unaccepted calibration was put aside. `alarm`: an alarm was opened, acknowledged "
        "or closed. `settings`: the scanner's description was changed. `schedule`: a schedule was made, changed or "
        "deleted, or a due time was missed. `scan`: a scan was refused.",
        examples=["calibration"],
    )
    type: EventType = Field(
        description="Kind of event, as in events: `succeeded`, `failed` or `cancelled` of a calibration or a drift "
        "check, `calibration-rolled-back` of an activation, `alarm-opened`, `scanner-changed`, and so on.",
        examples=["succeeded"],
    )
    subject: str = Field(
        description="Type of `subject_id`: `calibration`, `drift`, `scanner`, `schedule` or `scan`.",
        examples=["calibration"],
    )
    subject_id: Identifier = Field(description="Id of the subject.")
    link: str | None = Field(
        description="Path of the subject. Null: the subject was deleted since.", examples=["/v1/calibrations/example"]
    )
    who: str | None = Field(
        description="Who requested a calibration or a drift check, or cancelled it; for other entries who acted. "
        "The name of a key, `schedule` and its id, or `the service`. Null: an earlier version did not store it.",
        examples=["scanner software of line 2"],
    )
    key_id: Identifier | None = Field(
        description="Id of the key in `who`. Null: `who` names no key.", examples=["0f8b4c6d0d8a4b0e"]
    )
    why: str | None = Field(
        description="English reason: given with an activation, reported by a calibration or a drift check, of a "
        "failure, what is missing, or what was changed and from what. Null: nothing is known.",
        examples=["checked by hand"],
    )
    alarm: AlarmKind | None = Field(
        description="Kind of alarm. Null: the entry concerns no alarm.", examples=["no-phantom-scan"]
    )
    measured: Measurement | None = Field(
        description="Measurement of a calibration or a drift check that succeeded. Null: any other entry."
    )


class Activation(Contract):
    """An entry of kind `activation`, as version 0.1.0 had it: the time from which a calibration was the active one."""

    calibration_id: Identifier = Field(description="Id of the calibration.")
    activated_at: str = Field(
        description="Time at which the calibration became the active one, RFC 3339, UTC.",
        examples=["2026-03-02T05:31:04Z"],
    )
    activated_by: str | None = Field(
        None,
        description="Name of the key; null: an entry from before there was an audit.",
        examples=["scanner software of line 2"],
    )
    reason: str = Field(description="Reason of the activation.", examples=["checked by hand"])

    @classmethod
    def of(cls, entry: HistoryEntry) -> Self:
        """Build the activation from an entry of this kind."""
        return cls(
            calibration_id=entry.subject_id,
            activated_at=entry.at.isoformat(),
            activated_by=entry.who,
            reason=entry.why or "",
        )


class HistoryMark(NamedTuple):
    """Mark of an entry in a chart; the fields are those in `HistoryEntry`."""

    at: datetime
    kind: HistoryKind
    type: EventType
    subject_id: str
    alarm: AlarmKind | None
