"""The time zone of the mill, which names, reports and pages write times in: the newest decision about it."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import EventRow
from sawmill_platform.ledger.events import announce


class MillZone:
    """Store of the mill's time zone: every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def get(self) -> str | None:
        """Return the name of the zone, such as Europe/Helsinki; None where nobody has set it."""
        with self._database.read() as session:
            return _newest(session)

    def set(self, time_zone: str, *, first: bool = False) -> None:
        """Set the zone; with `first` only where nobody has set one."""
        with self._database.write() as session:
            before = _newest(session)
            if before == time_zone or (first and before is not None):
                return
            detail = {"time_zone": time_zone}
            announce(
                session, self._database.now(), mill_events.TIME_ZONE_SET, "mill", "mill", detail=detail, decided=detail
            )


def _newest(session: Session) -> str | None:
    decisions = select(EventRow.detail).where(EventRow.type == mill_events.TIME_ZONE_SET)
    detail = session.scalar(decisions.order_by(EventRow.number.desc()).limit(1))
    return None if detail is None else str(detail["time_zone"])
