"""Browsers that brought a key: each has a secret of its own, and ends with the key whose hash it keeps.

Whether that key still opens anything is for whoever finds a session to ask, at every request.
"""

import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, and_, delete, or_, select, update

from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.database.database import Database
from sawmill_platform.database.tables import KeyRow, SessionRow
from sawmill_platform.keys.key_store import RANDOM_BYTES, hash_of, opened_by
from sawmill_platform.ledger.events import announce

# A shift and its overtime without a request in between; a display's session lasts as long as its key.
LASTS = timedelta(hours=12)
# How exactly the last request is kept: each step is a write.
RENEWAL_STEP = timedelta(hours=1)
# Of one key: a newer one takes the place of the oldest.
MOST_OF_A_KEY = 20


@dataclass(frozen=True)
class BrowserSession:
    """A session that has not run out.

    Attributes
    ----------
    secret_hash, opened_by_hash : str
        Of its own secret, and of the key or the token that opened it.
    expires_at : datetime or None
        Unless it is renewed; None: with what opened it.
    """

    secret_hash: str
    opened_by_hash: str
    expires_at: datetime | None


class Sessions:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def open(self, opened_by_hash: str, *, lasting: bool, in_place_of: str = "") -> str:
        """Log whoever acts in, and remove the sessions that have ended.

        Parameters
        ----------
        opened_by_hash
            Of a key or token that was found good.
        lasting
            Whether it ends with the key alone.
        in_place_of
            The secret of the browser's session until now, if it has one: it ends.

        Returns
        -------
        str
            The session's secret, which is stored nowhere.
        """
        now, secret = self._database.now(), secrets.token_urlsafe(RANDOM_BYTES)
        row = SessionRow(
            secret_hash=hash_of(secret),
            opened_by_hash=opened_by_hash,
            created_at=now,
            expires_at=None if lasting else now + LASTS,
        )
        with self._database.write() as session:
            over = or_(SessionRow.secret_hash == hash_of(in_place_of), _has_ended(now))
            session.execute(delete(SessionRow).where(over).execution_options(synchronize_session=False))
            of_opener = select(SessionRow).where(SessionRow.opened_by_hash == opened_by_hash)
            oldest = of_opener.order_by(SessionRow.created_at.desc()).offset(MOST_OF_A_KEY - 1)
            for beyond in session.scalars(oldest):
                session.delete(beyond)
            session.add(row)
            announce(session, now, event_kinds.LOGGED_IN, "key", _who(), decided={"lasting": lasting})
        return secret

    def find(self, secret: str) -> BrowserSession | None:
        """The session of a secret, if it has not run out."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(SessionRow, hash_of(secret))
            if row is None or (row.expires_at is not None and row.expires_at <= now):
                return None
            return BrowserSession(row.secret_hash, row.opened_by_hash, row.expires_at)

    def renew(self, found: BrowserSession) -> None:
        """Have a session that is used last `LASTS` from now on; at most one write an hour."""
        now = self._database.now()
        if found.expires_at is None or found.expires_at > now + LASTS - RENEWAL_STEP:
            return
        with self._database.write() as session:
            this = SessionRow.secret_hash == found.secret_hash
            session.execute(update(SessionRow).where(this).values(expires_at=now + LASTS))

    def end(self, secret: str) -> None:
        """Log whoever acts out; a session that has gone already stays gone."""
        now = self._database.now()
        with self._database.write() as session:
            row = session.get(SessionRow, hash_of(secret))
            if row is not None:
                session.delete(row)
                announce(session, now, event_kinds.LOGGED_OUT, "key", _who())


def _who() -> str:
    return actor().key_id or "token"


def _has_ended(now: datetime) -> ColumnElement[bool]:
    """Run out, or a display's whose key opens nothing any more."""
    good = and_(KeyRow.revoked_at.is_(None), or_(KeyRow.expires_at.is_(None), KeyRow.expires_at > now))
    opener = select(KeyRow.id).where(good, opened_by(SessionRow.opened_by_hash, now))
    return or_(SessionRow.expires_at <= now, and_(SessionRow.expires_at.is_(None), ~opener.exists()))
