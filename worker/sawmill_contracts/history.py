"""A scanner's history: what became of it, when, by whom and why, in rows that outlast what they are about."""

from datetime import datetime
from enum import StrEnum
from typing import NamedTuple, Self

from pydantic import Field

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.measurements import Measurement
from sawmill_platform.contracts.base import Contract, Identifier, Time
from sawmill_platform.contracts.event_kinds import EventKind


class HistoryKind(StrEnum):
    """What an entry is about."""

    CALIBRATION = "calibration"
    DRIFT_CHECK = "drift-check"
    ACTIVATION = "activation"
    ALARM = "alarm"
    SETTINGS = "settings"
    SCHEDULE = "schedule"
    SCAN = "scan"


class HistoryEntry(Contract):
    """One thing that happened to a scanner."""

    number: int = Field(description="Number of the entry.", examples=[12])
    at: Time = Field(description="When it happened; of a calibration or a drift check, when its job ended.")
    kind: HistoryKind = Field(
        description="`calibration`, `drift-check`: one that ended. `activation`: from then on a calibration was the "
        "active one. `alarm`: one was opened or closed. `settings`: of the scanner. `schedule`: one was made, "
        "changed or deleted, or a due time was missed. `scan`: one was refused.",
        examples=["calibration"],
    )
    what: EventKind = Field(
        description="What happened, as in events: `succeeded`, `failed` or `cancelled` of a calibration or a drift "
        "check, `calibration-rolled-back` of an activation, `alarm-opened`, `scanner-changed`, and so on.",
        examples=["succeeded"],
    )
    subject: str = Field(
        description="What `subject_id` names: `calibration`, `drift`, `scanner`, `schedule` or `scan`.",
        examples=["calibration"],
    )
    subject_id: Identifier = Field(description="What it happened to.", examples=["example"])
    link: str | None = Field(
        description="Path of what it happened to. Null: that was deleted since.",
        examples=["/v1/calibrations/example"],
    )
    who: str | None = Field(
        description="Of a calibration or a drift check who asked for it, of a cancelled one who cancelled it; else who "
        "did it. The name of a key, `schedule` and its id, or `the service`. Null: an earlier version did not keep it.",
        examples=["scanner software of line 2"],
    )
    key_id: Identifier | None = Field(description="Id of that key. Null: it was none.", examples=["0f8b4c6d0d8a4b0e"])
    why: str | None = Field(
        description="In English: the reason given with an activation, what a calibration or a drift check says, why "
        "one failed, what is missing, what was changed and from what. Null: nothing is known.",
        examples=["checked by hand"],
    )
    alarm: AlarmKind | None = Field(
        description="Which alarm. Null: the entry is of none.", examples=["no-phantom-scan"]
    )
    measured: Measurement | None = Field(
        description="What a calibration or a drift check that succeeded measured. Null: any other entry."
    )


class Activation(Contract):
    """An entry of kind `activation`, as version 0.1.0 had it: from then on this calibration was the active one."""

    calibration_id: Identifier = Field(description="Id of the calibration.", examples=["example"])
    activated_at: str = Field(
        description="When it became the active one, RFC 3339, UTC.", examples=["2026-03-02T05:31:04Z"]
    )
    activated_by: str | None = Field(
        None,
        description="The name of the key; null: an entry from before there was an audit.",
        examples=["scanner software of line 2"],
    )
    reason: str = Field(description="Who or what activated it.", examples=["checked by hand"])

    @classmethod
    def of(cls, entry: HistoryEntry) -> Self:
        """That of an entry of its kind."""
        return cls(
            calibration_id=entry.subject_id,
            activated_at=entry.at.isoformat(),
            activated_by=entry.who,
            reason=entry.why or "",
        )


class HistoryMark(NamedTuple):
    """What a chart marks of an entry; the fields are those of `HistoryEntry`."""

    at: datetime
    kind: HistoryKind
    what: EventKind
    subject_id: str
    alarm: AlarmKind | None
