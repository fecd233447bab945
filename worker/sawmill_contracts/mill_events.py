"""Kinds of events of a mill: what happens to scanners and to what belongs to them."""

from sawmill_platform.contracts.event_kinds import EventKind

TIME_ZONE_SET = EventKind.register("time-zone-set", "a person set the time zone of the mill", is_decision=True)
SCANNER_CREATED = EventKind.register("scanner-created", is_decision=True, topic="settings")
SCANNER_CHANGED = EventKind.register("scanner-changed", is_decision=True, topic="settings")
SCANNER_DELETED = EventKind.register("scanner-deleted", is_decision=True)
CALIBRATION_ACTIVATED = EventKind.register("calibration-activated", is_decision=True, topic="activation")
CALIBRATION_ROLLED_BACK = EventKind.register("calibration-rolled-back", is_decision=True, topic="activation")
CALIBRATION_DISCARDED = EventKind.register(
    "calibration-discarded", "a person put a failed or unaccepted calibration aside", is_decision=True, topic="discard"
)
SCAN_READY = EventKind.register("scan-ready")
SCAN_REFUSED = EventKind.register("scan-refused", topic="scan")
SCAN_DELETED = EventKind.register("scan-deleted", is_decision=True)
RECONSTRUCTION_RENAMED = EventKind.register("reconstruction-renamed", is_decision=True)
PHANTOM_CREATED = EventKind.register("phantom-created")
PHANTOM_READY = EventKind.register("phantom-ready")
PHANTOM_REFUSED = EventKind.register("phantom-refused")
PHANTOM_DELETED = EventKind.register("phantom-deleted", is_decision=True)
SCHEDULE_CREATED = EventKind.register("schedule-created", is_decision=True, topic="schedule")
SCHEDULE_CHANGED = EventKind.register("schedule-changed", is_decision=True, topic="schedule")
SCHEDULE_DELETED = EventKind.register("schedule-deleted", is_decision=True, topic="schedule")
SCHEDULE_MISSED = EventKind.register(
    "schedule-missed", "nothing was queued at `due_at`, for `reason`; reported once", topic="schedule"
)
INSPECTION_DELETED = EventKind.register("inspection-deleted", is_decision=True)
ALARM_OPENED = EventKind.register(
    "alarm-opened", "`detail` is the alarm, which `/v1/alarms` lists until `alarm-closed`", topic="alarm"
)
ALARM_ACKNOWLEDGED = EventKind.register(
    "alarm-acknowledged", "a person took notice of an open alarm, `until` a time", is_decision=True, topic="alarm"
)
RED_ACKNOWLEDGED = EventKind.register(
    "red-acknowledged",
    "a person knows why the scanner is red, `until` a time: the `results` that showed it are named",
    is_decision=True,
    topic="alarm",
)
ALARM_CLOSED = EventKind.register("alarm-closed", topic="alarm")
