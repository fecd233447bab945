from enum import StrEnum


class HistoryKind(StrEnum):
    ACTIVATION = "activation"
    ALARM = "alarm"
    CALIBRATION = "calibration"
    DRIFT_CHECK = "drift-check"
    SCAN = "scan"
    SCHEDULE = "schedule"
    SETTINGS = "settings"

    def __str__(self) -> str:
        return str(self.value)
