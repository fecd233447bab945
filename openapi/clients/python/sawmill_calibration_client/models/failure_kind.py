from enum import StrEnum


class FailureKind(StrEnum):
    INPUT = "input"
    INTERNAL = "internal"
    PASSING = "passing"

    def __str__(self) -> str:
        return str(self.value)
