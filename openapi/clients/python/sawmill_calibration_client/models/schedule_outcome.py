from enum import StrEnum


class ScheduleOutcome(StrEnum):
    NO_NEW_PHANTOM_SCAN = "no-new-phantom-scan"
    QUEUED = "queued"

    def __str__(self) -> str:
        return str(self.value)
