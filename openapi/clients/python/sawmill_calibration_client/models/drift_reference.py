from enum import StrEnum


class DriftReference(StrEnum):
    BASELINE = "baseline"
    CALIBRATION = "calibration"

    def __str__(self) -> str:
        return str(self.value)
