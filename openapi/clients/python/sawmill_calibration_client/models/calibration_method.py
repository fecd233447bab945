from enum import StrEnum


class CalibrationMethod(StrEnum):
    DEFAULT = "default"
    PAPER = "paper"

    def __str__(self) -> str:
        return str(self.value)
