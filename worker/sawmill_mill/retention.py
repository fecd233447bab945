"""The reasons for which a thing stays although rules of retention reach it."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_contracts.retention import RetentionKind, StaysBecause

_SCANS = (StaysBecause.UNFINISHED_JOB, StaysBecause.ACTIVE_CALIBRATION, StaysBecause.NEWEST, StaysBecause.SCHEDULE)

STAYS: Mapping[RetentionKind, tuple[StaysBecause, ...]] = MappingProxyType(
    {
        RetentionKind.LOG_SCANS: _SCANS,
        RetentionKind.PHANTOM_SCANS: _SCANS,
        RetentionKind.RECONSTRUCTIONS: (StaysBecause.UNFINISHED_JOB,),
        RetentionKind.CALIBRATIONS: (
            StaysBecause.UNFINISHED_JOB,
            StaysBecause.ACTIVE_CALIBRATION,
            StaysBecause.ONCE_ACTIVE,
            StaysBecause.REFERRED_TO,
            StaysBecause.NEWEST,  # a schedule knows by it that the newest phantom scan was used
        ),
        # A schedule knows by the newest checks which logs were checked: it continues after the newest of these.
        RetentionKind.DRIFTS: (StaysBecause.UNFINISHED_JOB, StaysBecause.SCHEDULE),
        RetentionKind.INSPECTIONS: (StaysBecause.UNFINISHED_JOB,),
        RetentionKind.EVENTS: (StaysBecause.NEWEST,),  # an alarm knows by it when the newest scan came, deleted or not
    }
)
"""The reasons that keep a thing of each kind; `Staying.because` describes what each reason means."""
