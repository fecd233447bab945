"""Entries of a scanner's history, written in the transaction of the event; `sawmill_store/history.py` reads them."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.history import HistoryKind
from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.contracts.kinds import declaration_of
from sawmill_platform.database.tables import AuditRow, JobRow
from sawmill_platform.ledger import events
from sawmill_store.tables import HistoryRow

_BY_EVENT = {
    mill_events.CALIBRATION_ACTIVATED: HistoryKind.ACTIVATION,
    mill_events.CALIBRATION_ROLLED_BACK: HistoryKind.ACTIVATION,
    mill_events.ALARM_OPENED: HistoryKind.ALARM,
    mill_events.ALARM_CLOSED: HistoryKind.ALARM,
    mill_events.SCAN_REFUSED: HistoryKind.SCAN,
}
_BY_SUBJECT = {
    "calibration": HistoryKind.CALIBRATION,
    "drift": HistoryKind.DRIFT_CHECK,
    "scanner": HistoryKind.SETTINGS,
    "schedule": HistoryKind.SCHEDULE,
}
# On its way to an end a job belongs to its own history; a scanner's goes with the scanner.
_LEFT_OUT = {
    event_kinds.QUEUED,
    event_kinds.STARTED,
    event_kinds.LOST,
    event_kinds.PUT_OFF,
    event_kinds.GIVEN_BACK,
    event_kinds.CANCEL_REQUESTED,
    mill_events.SCANNER_DELETED,
}


def announce(
    session: Session,
    now: datetime,
    what: EventKind,
    subject: str,
    subject_id: str,
    *,
    scanner_id: str | None = None,
    detail: dict[str, Any] | None = None,
    why: str | None = None,
    alarm: AlarmKind | None = None,
) -> None:
    """Add an event of anything but an attempt at a job, and enter it in its scanner's history.

    Parameters
    ----------
    session, now
        The transaction of the change, and its time.
    what
        The kind of event.
    subject, subject_id
        What it happened to: `scan` and its id.
    scanner_id
        The scanner that it concerns.
    detail
        More about it, of few words: events are sent to whoever follows them.
    why, alarm
        For the history: a sentence, by default the `reason` of the detail, and which alarm it is about.
    """
    events.announce(session, now, what, subject, subject_id, group_id=scanner_id, detail=detail)
    by, why = actor(), why or (detail or {}).get("reason")
    enter(session, now, what, subject, subject_id, scanner_id, who=by.name, key_id=by.key_id, why=why, alarm=alarm)


def enter_job(session: Session, now: datetime, what: EventKind, job: JobRow, detail: dict[str, Any] | None) -> None:
    """Enter an event of a job in its scanner's history; `sawmill_store/measurements.py` enters a success."""
    if what is event_kinds.SUCCEEDED:
        return
    who, key_id = _canceller(session, job) if what is event_kinds.CANCELLED else (job.asked_by, job.key_id)
    noun, why = declaration_of(job.kind).noun, (detail or {}).get("detail")
    enter(session, now, what, noun, job.subject_id, job.group_id or None, who=who, key_id=key_id, why=why)


def _canceller(session: Session, job: JobRow) -> tuple[str | None, str | None]:
    """Return the name and the key's id of whoever cancelled a job."""
    entries = select(AuditRow.who, AuditRow.key_id).where(
        AuditRow.subject_id == job.id, AuditRow.action == event_kinds.JOB_CANCELLED
    )
    found = session.execute(entries.order_by(AuditRow.number.desc()).limit(1)).one_or_none()
    return (None, None) if found is None else (found.who, found.key_id)


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
