"""Decisions about calibrations: those that a scanner has used, the active one, and those that were discarded."""

from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, select, text
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_contracts import mill_events
from sawmill_contracts.history import HistoryKind
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import JobState
from sawmill_platform.database.tables import IN_HISTORY, EventRow, JobRow
from sawmill_platform.ledger.events import announce
from sawmill_store.mill_tables import ActivationRow, ReconstructionRow

# A scanner's id, or the column of another statement that has it.
ScannerId = str | InstrumentedAttribute[str]


def active_since(session: Session, scanner_id: str) -> ActivationRow | None:
    """Return the activation since which a scanner has its active calibration.

    Version 0.1.0 wrote repeated activations of one calibration as further rows; the first of these rows is returned.
    """
    of_scanner, active = ActivationRow.scanner_id == scanner_id, active_calibration(scanner_id).scalar_subquery()
    newest_other = select(func.max(ActivationRow.number)).where(of_scanner, ActivationRow.calibration_id != active)
    since = ActivationRow.number > func.coalesce(newest_other.scalar_subquery(), 0)
    return session.scalar(select(ActivationRow).where(of_scanner, since).order_by(ActivationRow.number).limit(1))


def active_calibration_id(session: Session, scanner_id: str) -> str | None:
    """Read the id of a scanner's active calibration; None where no calibration was activated."""
    return session.scalar(active_calibration(scanner_id))


def active_calibration(scanner_id: ScannerId) -> Select[str]:
    """Select the id of a scanner's active calibration: the calibration of the newest activation."""
    activated = select(ActivationRow.calibration_id).where(ActivationRow.scanner_id == scanner_id)
    return activated.order_by(ActivationRow.number.desc()).limit(1)


def activate(session: Session, scanner_id: str, calibration_id: str, reason: str, now: datetime) -> None:
    """Make a calibration the active one, with an entry in history and audit; do nothing where it is active already."""
    if calibration_id == active_calibration_id(session, scanner_id):
        return
    history = select(ActivationRow.calibration_id).where(ActivationRow.scanner_id == scanner_id)
    again = calibration_id in session.scalars(history)
    what = mill_events.CALIBRATION_ROLLED_BACK if again else mill_events.CALIBRATION_ACTIVATED
    _announce(session, what, scanner_id, calibration_id, reason, now)
    session.add(ActivationRow(scanner_id=scanner_id, calibration_id=calibration_id, activated_at=now, reason=reason))
    session.flush()
    if not again:
        # Name the calibration in reconstructions that wait for the first one that a new scanner activates.
        waiting = select(ReconstructionRow).join(JobRow, ReconstructionRow.job_id == JobRow.id)
        waiting = waiting.where(ReconstructionRow.scanner_id == scanner_id, ReconstructionRow.calibration_id.is_(None))
        for row in session.scalars(waiting.where(JobRow.state == JobState.QUEUED)):
            if row.options.get("theta") is None:
                row.calibration_id = calibration_id


def discard(session: Session, scanner_id: str, calibration_id: str, reason: str, now: datetime) -> None:
    """Put a calibration aside, with an entry in history and audit; do nothing where it was put aside before."""
    if calibration_id in session.scalars(discards(EventRow.subject_id, scanner_id)):
        return
    _announce(session, mill_events.CALIBRATION_DISCARDED, scanner_id, calibration_id, reason, now)


def _announce(
    session: Session, what: EventType, scanner_id: str, calibration_id: str, reason: str, now: datetime
) -> None:
    detail = {"reason": reason}
    decided = {"scanner_id": scanner_id, **detail}
    announce(session, now, what, "calibration", calibration_id, group_id=scanner_id, detail=detail, decided=decided)


def discards(column: Any, scanner_id: ScannerId) -> Select[Any]:  # noqa: ANN401 - functions of columns too
    """Select a column of the events by which a scanner's calibrations were discarded."""
    return select(column).where(
        text(IN_HISTORY), EventRow.group_id == scanner_id, EventRow.topic == HistoryKind.DISCARD
    )
