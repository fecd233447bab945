from enum import StrEnum


class DriftFindingKind(StrEnum):
    JUMP = "jump"
    LEARNING = "learning"
    QUIET = "quiet"
    TREND = "trend"

    def __str__(self) -> str:
        return str(self.value)
