from enum import StrEnum


class ScheduleKind(StrEnum):
    CHECK_DRIFT = "check-drift"
    RECALIBRATE = "recalibrate"

    def __str__(self) -> str:
        return str(self.value)
