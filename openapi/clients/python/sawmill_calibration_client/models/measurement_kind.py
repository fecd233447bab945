from enum import StrEnum


class MeasurementKind(StrEnum):
    CALIBRATION = "calibration"
    DRIFT = "drift"

    def __str__(self) -> str:
        return str(self.value)
