from enum import StrEnum


class EventKind(StrEnum):
    CALIBRATION_ACTIVATED = "calibration-activated"
    CALIBRATION_ROLLED_BACK = "calibration-rolled-back"
    CANCELLED = "cancelled"
    CLOCK_OFF = "clock-off"
    CLOCK_STEPPED = "clock-stepped"
    FAILED = "failed"
    GIVEN_BACK = "given-back"
    LOST = "lost"
    PHANTOM_CREATED = "phantom-created"
    PHANTOM_DELETED = "phantom-deleted"
    PHANTOM_READY = "phantom-ready"
    PHANTOM_REFUSED = "phantom-refused"
    PUT_OFF = "put-off"
    QUEUED = "queued"
    SCANNER_CHANGED = "scanner-changed"
    SCANNER_CREATED = "scanner-created"
    SCANNER_DELETED = "scanner-deleted"
    SCAN_DELETED = "scan-deleted"
    SCAN_READY = "scan-ready"
    SCAN_REFUSED = "scan-refused"
    SCHEDULE_CHANGED = "schedule-changed"
    SCHEDULE_CREATED = "schedule-created"
    SCHEDULE_DELETED = "schedule-deleted"
    SCHEDULE_MISSED = "schedule-missed"
    STARTED = "started"
    SUCCEEDED = "succeeded"

    def __str__(self) -> str:
        return str(self.value)
