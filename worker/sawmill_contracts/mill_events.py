"""Kinds of events of a mill: what happens to scanners and to what belongs to them."""

from sawmill_platform.contracts.event_kinds import EventType

TIME_ZONE_SET = EventType.register("time-zone-set", "a person set the time zone of the mill", is_decision=True)
SCANNER_CREATED = EventType.register("scanner-created", is_decision=True, topic="settings")
SCANNER_CHANGED = EventType.register("scanner-changed", is_decision=True, topic="settings")
SCANNER_DELETED = EventType.register("scanner-deleted", is_decision=True)
CALIBRATION_ACTIVATED = EventType.register("calibration-activated", is_decision=True, topic="activation")
CALIBRATION_ROLLED_BACK = EventType.register("calibration-rolled-back", is_decision=True, topic="activation")
CALIBRATION_DISCARDED = EventType.register(
    "calibration-discarded", "a person put a failed or unaccepted calibration aside", is_decision=True, topic="discard"
)
SCAN_READY = EventType.register("scan-ready")
SCAN_REFUSED = EventType.register("scan-refused", topic="scan")
SCAN_DELETED = EventType.register("scan-deleted", is_decision=True)
RECONSTRUCTION_RENAMED = EventType.register("reconstruction-renamed", is_decision=True)
RECONSTRUCTION_MARKED = EventType.register(
    "reconstruction-marked", "a person kept, changed or removed a ruler or a region in a slice", is_decision=True
)
PHANTOM_CREATED = EventType.register("phantom-created")
PHANTOM_READY = EventType.register("phantom-ready")
PHANTOM_REFUSED = EventType.register("phantom-refused")
PHANTOM_DELETED = EventType.register("phantom-deleted", is_decision=True)
SCHEDULE_CREATED = EventType.register("schedule-created", is_decision=True, topic="schedule")
SCHEDULE_CHANGED = EventType.register("schedule-changed", is_decision=True, topic="schedule")
SCHEDULE_DELETED = EventType.register("schedule-deleted", is_decision=True, topic="schedule")
SCHEDULE_MISSED = EventType.register(
    "schedule-missed", "nothing was queued at `due_at`, for `reason`; reported once", topic="schedule"
)
INSPECTION_DELETED = EventType.register("inspection-deleted", is_decision=True)
ALARM_OPENED = EventType.register(
    "alarm-opened", "`detail` is the alarm, which `/v1/alarms` lists until `alarm-closed`", topic="alarm"
)
ALARM_ACKNOWLEDGED = EventType.register(
    "alarm-acknowledged", "a person took notice of an open alarm, `until` a time", is_decision=True, topic="alarm"
)
RED_ACKNOWLEDGED = EventType.register(
    "red-acknowledged",
    "a person knows why the scanner is red, `until` a time: the `results` that showed it are named",
    is_decision=True,
    topic="alarm",
)
ALARM_CLOSED = EventType.register("alarm-closed", topic="alarm")
