from enum import StrEnum


class StaysBecause(StrEnum):
    ACTIVE_CALIBRATION = "active-calibration"
    NEWEST = "newest"
    ONCE_ACTIVE = "once-active"
    REFERRED_TO = "referred-to"
    SCHEDULE = "schedule"
    UNFINISHED_JOB = "unfinished-job"

    def __str__(self) -> str:
        return str(self.value)
