from enum import StrEnum


class AuditAction(StrEnum):
    CALIBRATION_ACTIVATED = "calibration-activated"
    CALIBRATION_ROLLED_BACK = "calibration-rolled-back"
    INSPECTION_DELETED = "inspection-deleted"
    JOB_CANCELLED = "job-cancelled"
    KEY_CREATED = "key-created"
    KEY_REVOKED = "key-revoked"
    KEY_ROTATED = "key-rotated"
    LOGGED_IN = "logged-in"
    LOGGED_OUT = "logged-out"
    PHANTOM_DELETED = "phantom-deleted"
    RETENTION_CHANGED = "retention-changed"
    SCANNER_CHANGED = "scanner-changed"
    SCANNER_CREATED = "scanner-created"
    SCANNER_DELETED = "scanner-deleted"
    SCAN_DELETED = "scan-deleted"
    SCHEDULE_CHANGED = "schedule-changed"
    SCHEDULE_CREATED = "schedule-created"
    SCHEDULE_DELETED = "schedule-deleted"
    WEBHOOK_CHANGED = "webhook-changed"
    WEBHOOK_CREATED = "webhook-created"
    WEBHOOK_DELETED = "webhook-deleted"
    WEBHOOK_ROTATED = "webhook-rotated"
    WEBHOOK_TESTED = "webhook-tested"

    def __str__(self) -> str:
        return str(self.value)
