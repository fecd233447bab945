"""What no rule of retention deletes, and why."""

from collections.abc import Collection, Mapping
from types import MappingProxyType

from sawmill_contracts.retention import RetentionKind, StaysBecause

_MADE = "a job that has not ended makes it"
_SCANS = MappingProxyType(
    {
        StaysBecause.UNFINISHED_JOB: "a job that has not ended reads it or will read it",
        StaysBecause.ACTIVE_CALIBRATION: "a calibration in use was made of it: the active one or the one before it",
        StaysBecause.NEWEST: "it is the newest readable log of its scanner, or the newest usable phantom scan",
        StaysBecause.SCHEDULE: "a schedule would check it for drift next",
    }
)

STAYS: Mapping[RetentionKind, Mapping[StaysBecause, str]] = MappingProxyType(
    {
        RetentionKind.LOG_SCANS: _SCANS,
        RetentionKind.PHANTOM_SCANS: _SCANS,
        RetentionKind.RECONSTRUCTIONS: {StaysBecause.UNFINISHED_JOB: _MADE},
        RetentionKind.CALIBRATIONS: {
            StaysBecause.UNFINISHED_JOB: _MADE,
            StaysBecause.ACTIVE_CALIBRATION: "it is the active one of its scanner, or the one before it",
            StaysBecause.ONCE_ACTIVE: "its scanner has used it before these two",
            StaysBecause.REFERRED_TO: "a reconstruction, a drift check or another job that is stored used it",
            StaysBecause.NEWEST: "it is of the newest phantom scan: a schedule knows by it that the scan was used",
        },
        RetentionKind.DRIFTS: {
            StaysBecause.UNFINISHED_JOB: _MADE,
            StaysBecause.SCHEDULE: "it is of the newest log that was checked: a schedule continues after that log",
        },
        RetentionKind.INSPECTIONS: {StaysBecause.UNFINISHED_JOB: _MADE},
        RetentionKind.EVENTS: {
            StaysBecause.NEWEST: "it is of the newest scan: an alarm knows by it when that came, deleted or not",
        },
    }
)
"""By kind, each reason for which a thing stays, and what the reason means for that kind."""


def stays_because(kind: RetentionKind, facts: Collection[StaysBecause]) -> list[StaysBecause]:
    """Return the reasons that keep a thing, of which these facts are true; it may be deleted if there is none."""
    return [because for because in STAYS[kind] if because in facts]
