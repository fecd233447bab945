from enum import StrEnum


class ScheduleOutcome(StrEnum):
    NO_ACTIVE_CALIBRATION = "no-active-calibration"
    NO_NEW_LOG_SCAN = "no-new-log-scan"
    NO_NEW_PHANTOM_SCAN = "no-new-phantom-scan"
    QUEUED = "queued"

    def __str__(self) -> str:
        return str(self.value)
