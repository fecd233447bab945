from enum import StrEnum


class RetentionKind(StrEnum):
    CALIBRATIONS = "calibrations"
    DRIFTS = "drifts"
    EVENTS = "events"
    INSPECTIONS = "inspections"
    LOG_SCANS = "log-scans"
    PHANTOM_SCANS = "phantom-scans"
    RECONSTRUCTIONS = "reconstructions"

    def __str__(self) -> str:
        return str(self.value)
