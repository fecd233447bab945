"""Sessions of browsers that sent a key: each has its own secret, and ends with the key whose hash it keeps.

The code that finds a session must check, at every request, that the key is still valid.
"""

import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, and_, delete, or_, select, update

from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import found
from sawmill_platform.database.tables import KeyRow, SessionRow
from sawmill_platform.keys.key_store import RANDOM_BYTES, hash_of, opened_by
from sawmill_platform.ledger.events import announce

# A shift and its overtime without a request in between; a display's session lasts as long as its key.
LASTS = timedelta(hours=12)
# Precision of the time of the last request: each step is a write.
RENEWAL_STEP = timedelta(hours=1)
# Time within which a link for a display must be opened, once.
LINK_LASTS = timedelta(minutes=10)
# Sessions of one key: a newer one replaces the oldest.
MOST_OF_A_KEY = 20


@dataclass(frozen=True)
class BrowserSession:
    """A session that has not ended."""

    # secret_hash, opened_by_hash: hashes of the session's own secret, and of the key or the token that opened it.
    secret_hash: str
    opened_by_hash: str
    expires_at: datetime | None  # end of the session unless it is renewed; None: the session ends with its key or token


class Sessions:
    """Store of sessions; every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def open(self, opened_by_hash: str, *, lasting: bool, in_place_of: str = "") -> str:
        """Log the actor in, and remove the sessions that have ended.

        Parameters
        ----------
        opened_by_hash
            Hash of a key or token that is valid.
        lasting
            Whether the session ends only with the key.
        in_place_of
            Secret of the browser's present session, which ends; empty: there is none.

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
            for beyond in session.scalars(of_opener.order_by(SessionRow.created_at.desc()).offset(MOST_OF_A_KEY - 1)):
                session.delete(beyond)
            session.add(row)
            announce(session, now, event_kinds.LOGGED_IN, "key", _who(), decided={"lasting": lasting})
        return secret

    def invite(self, key_id: str) -> str:
        """Make a link that logs one browser in with a key, once and soon; return its secret, which is stored nowhere.

        Raises
        ------
        NotFound
            There is no such key.
        """
        now, secret = self._database.now(), secrets.token_urlsafe(RANDOM_BYTES)
        with self._database.write() as session:
            opener = found(session, KeyRow, "key", key_id).secret_hash
            hashed, until = hash_of_link(secret), now + LINK_LASTS
            session.add(SessionRow(secret_hash=hashed, opened_by_hash=opener, created_at=now, expires_at=until))
        return secret

    def use_link(self, secret: str) -> str | None:
        """Use a link up; return the hash of the key that it logs in with, or None if it was used or has expired."""
        now = self._database.now()
        with self._database.write() as session:
            row = session.get(SessionRow, hash_of_link(secret), with_for_update=True)
            if row is None:
                return None
            session.delete(row)
            return row.opened_by_hash if row.expires_at is not None and row.expires_at > now else None

    def find(self, secret: str) -> BrowserSession | None:
        """Return the session of a secret, or None if it has ended."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(SessionRow, hash_of(secret))
            if row is None or (row.expires_at is not None and row.expires_at <= now):
                return None
            return BrowserSession(row.secret_hash, row.opened_by_hash, row.expires_at)

    def renew(self, used: BrowserSession) -> None:
        """Extend a session in use to `LASTS` from now; at most one write an hour."""
        now = self._database.now()
        if used.expires_at is None or used.expires_at > now + LASTS - RENEWAL_STEP:
            return
        with self._database.write() as session:
            this = SessionRow.secret_hash == used.secret_hash
            session.execute(update(SessionRow).where(this).values(expires_at=now + LASTS))

    def end(self, secret: str) -> None:
        """Log the actor out; a session that has ended already stays ended."""
        now = self._database.now()
        with self._database.write() as session:
            row = session.get(SessionRow, hash_of(secret))
            if row is not None:
                session.delete(row)
                announce(session, now, event_kinds.LOGGED_OUT, "key", _who())


def hash_of_link(secret: str) -> str:
    """Return what is stored of a link's secret: no session's secret and no key has such a hash."""
    return f"link-{hash_of(secret)}"[:64]


def _who() -> str:
    return actor().key_id or "token"


def _has_ended(now: datetime) -> ColumnElement[bool]:
    """Select sessions that have expired, and sessions of displays whose key is no longer valid."""
    good = and_(KeyRow.revoked_at.is_(None), or_(KeyRow.expires_at.is_(None), KeyRow.expires_at > now))
    opener = select(KeyRow.id).where(good, opened_by(SessionRow.opened_by_hash, now))
    return or_(SessionRow.expires_at <= now, and_(SessionRow.expires_at.is_(None), ~opener.exists()))
