"""Which calibration a scanner uses, and since when."""

from datetime import datetime

from sqlalchemy import Select, func, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from sawmill_contracts import mill_events
from sawmill_platform.ledger.events import announce
from sawmill_store.tables import ActivationRow

# A scanner's id, or the column of another statement that has it.
ScannerId = str | InstrumentedAttribute[str]


def active_since(session: Session, scanner_id: str) -> ActivationRow | None:
    """The activation since which a scanner has its active calibration; 0.1.0 noted repeats of it as further ones."""
    its, active = ActivationRow.scanner_id == scanner_id, active_calibration(scanner_id).scalar_subquery()
    others = select(func.max(ActivationRow.number)).where(its, ActivationRow.calibration_id != active)
    since = ActivationRow.number > func.coalesce(others.scalar_subquery(), 0)
    return session.scalar(select(ActivationRow).where(its, since).order_by(ActivationRow.number).limit(1))


def active_calibration_id(session: Session, scanner_id: str) -> str | None:
    """The newest activation's calibration."""
    return session.scalar(active_calibration(scanner_id))


def active_calibration(scanner_id: ScannerId) -> Select[str]:
    """The same, as a statement or a part of one."""
    activated = select(ActivationRow.calibration_id).where(ActivationRow.scanner_id == scanner_id)
    return activated.order_by(ActivationRow.number.desc()).limit(1)


def activate(session: Session, scanner_id: str, calibration_id: str, reason: str, now: datetime) -> None:
    """Add to the scanner's history, and to the audit; nothing where the calibration is the active one already."""
    if calibration_id == active_calibration_id(session, scanner_id):
        return
    history = select(ActivationRow.calibration_id).where(ActivationRow.scanner_id == scanner_id)
    again = calibration_id in session.scalars(history)
    what = mill_events.CALIBRATION_ROLLED_BACK if again else mill_events.CALIBRATION_ACTIVATED
    detail = {"reason": reason}
    decided = {"scanner_id": scanner_id, **detail}
    announce(session, now, what, "calibration", calibration_id, group_id=scanner_id, detail=detail, decided=decided)
    session.add(ActivationRow(scanner_id=scanner_id, calibration_id=calibration_id, activated_at=now, reason=reason))
    session.flush()
