"""The reasons for which a thing stays although rules of retention reach it."""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

from sawmill_contracts.retention import RetentionKind, StaysBecause


class Reason(NamedTuple):
    """A reason to keep a thing, and what it means for things of one kind."""

    because: StaysBecause
    meaning: str


_MADE = Reason(StaysBecause.UNFINISHED_JOB, "a job that has not ended makes it")
_SCANS = (
    Reason(StaysBecause.UNFINISHED_JOB, "a job that has not ended reads it or will read it"),
    Reason(StaysBecause.ACTIVE_CALIBRATION, "the active calibration was made of it, or the one before it"),
    Reason(StaysBecause.NEWEST, "it is the newest readable log of its scanner, or the newest usable phantom scan"),
    Reason(StaysBecause.SCHEDULE, "a schedule would check it for drift next"),
)

STAYS: Mapping[RetentionKind, tuple[Reason, ...]] = MappingProxyType(
    {
        RetentionKind.LOG_SCANS: _SCANS,
        RetentionKind.PHANTOM_SCANS: _SCANS,
        RetentionKind.RECONSTRUCTIONS: (_MADE,),
        RetentionKind.CALIBRATIONS: (
            _MADE,
            Reason(StaysBecause.ACTIVE_CALIBRATION, "it is the active one of its scanner, or the one before it"),
            Reason(StaysBecause.ONCE_ACTIVE, "its scanner has used it before these two"),
            Reason(StaysBecause.REFERRED_TO, "a reconstruction, a drift check or another stored job used it"),
            Reason(StaysBecause.NEWEST, "a schedule knows by it that the newest phantom scan was used"),
        ),
        RetentionKind.DRIFTS: (
            _MADE,
            Reason(StaysBecause.SCHEDULE, "it is of the newest log that was checked: a schedule continues after that"),
        ),
        RetentionKind.INSPECTIONS: (_MADE,),
        RetentionKind.EVENTS: (
            Reason(StaysBecause.NEWEST, "an alarm knows by it when the newest scan came, deleted or not"),
        ),
    }
)
"""The reasons by kind."""


def stays_because(kind: RetentionKind, facts: Collection[StaysBecause]) -> list[StaysBecause]:
    """Return the reasons that keep a thing, of which these facts are true; it may be deleted if there is none."""
    return [reason.because for reason in STAYS[kind] if reason.because in facts]
