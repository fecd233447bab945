"""Entries of a scanner's history, written in the transaction of the event; `sawmill_store/history.py` reads them."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.history import HistoryKind
from sawmill_platform.contracts.events import EventKind
from sawmill_platform.database.tables import HistoryRow

_BY_EVENT = {
    EventKind.CALIBRATION_ACTIVATED: HistoryKind.ACTIVATION,
    EventKind.CALIBRATION_ROLLED_BACK: HistoryKind.ACTIVATION,
    EventKind.ALARM_OPENED: HistoryKind.ALARM,
    EventKind.ALARM_CLOSED: HistoryKind.ALARM,
    EventKind.SCAN_REFUSED: HistoryKind.SCAN,
}
_BY_SUBJECT = {
    "calibration": HistoryKind.CALIBRATION,
    "drift": HistoryKind.DRIFT_CHECK,
    "scanner": HistoryKind.SETTINGS,
    "schedule": HistoryKind.SCHEDULE,
}
# On its way to an end a job belongs to its own history; a scanner's goes with the scanner.
_LEFT_OUT = {
    EventKind.QUEUED,
    EventKind.STARTED,
    EventKind.LOST,
    EventKind.PUT_OFF,
    EventKind.GIVEN_BACK,
    EventKind.CANCEL_REQUESTED,
    EventKind.SCANNER_DELETED,
}


def enter(
    session: Session,
    at: datetime,
    what: EventKind,
    subject: str,
    subject_id: str,
    scanner_id: str | None,
    *,
    who: str | None,
    key_id: str | None,
    why: str | None,
    alarm: AlarmKind | None = None,
    measurement_number: int | None = None,
) -> None:
    """Add what happened to a scanner's history, if it belongs there; the fields are those of `HistoryEntry`."""
    kind = kind_of(what, subject)
    if kind is None or scanner_id is None:
        return
    session.add(
        HistoryRow(
            scanner_id=scanner_id,
            at=at,
            kind=kind,
            what=what,
            subject=subject,
            subject_id=subject_id,
            who=who,
            key_id=key_id,
            why=why,
            alarm=alarm,
            measurement_number=measurement_number,
        )
    )


def kind_of(what: EventKind, subject: str) -> HistoryKind | None:
    """Return the kind of entry that an event makes; None where it is no part of a scanner's history."""
    return None if what in _LEFT_OUT else _BY_EVENT.get(what) or _BY_SUBJECT.get(subject)


def changes_in_words(difference: Mapping[str, Any]) -> str:
    """What was changed, by [before, after] of each name, as the audit has it: `name: "Line 3", was "Line 2"`."""
    words = [f"{name}: {json.dumps(after)}, was {json.dumps(before)}" for name, before, after in _parts(difference)]
    return "; ".join(words) or "nothing was changed"


def _parts(difference: Mapping[str, Any], within: str = "") -> Iterator[tuple[str, Any, Any]]:
    for name, (before, after) in difference.items():
        if isinstance(before, dict) and isinstance(after, dict):
            names = {**before, **after}
            pairs = {each: (before.get(each), after.get(each)) for each in names}
            changed = {each: pair for each, pair in pairs.items() if pair[0] != pair[1]}
            yield from _parts(changed, f"{within}{name}.")
        else:
            yield f"{within}{name}", before, after
