"""Keys, made, found by their secrets, rotated, revoked, and sessions of browsers that sent a key.

Only the SHA-256 of a secret is stored. A secret has 256 random bits: nobody can try them all, so a slow hash would
protect nothing and delay every request. A session has its own secret, and ends with the key whose hash it keeps: the
code that finds a session must check, at every request, that the key is still valid.
"""

import hashlib
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, and_, delete, or_, select, update
from sqlalchemy.orm import QueryableAttribute, Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.keys import Key, KeyRequest, NewKey
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import found, new_id, read_page
from sawmill_platform.database.tables import Json, KeyRow, SessionRow
from sawmill_platform.errors import Conflict, Invalid
from sawmill_platform.ledger.events import actor, announce

# Prefix by which search programs for leaked secrets recognise a secret.
PREFIX = "sawmill_"
RANDOM_BYTES = 32
# Precision of `last_used_at`: each step is a write.
USE_STEP = timedelta(minutes=1)


def hash_of(secret: str) -> str:
    """Return the hash of a secret, which is stored."""
    return hashlib.sha256(secret.encode()).hexdigest()


class KeyStore(StorePart):
    """Store of keys."""

    def create(self, ask: KeyRequest) -> NewKey:
        """Make a key.

        Raises
        ------
        Invalid
            The key would have expired already.
        """
        now, secret = self._database.now(), _new_secret()
        if ask.expires_at is not None and ask.expires_at <= now:
            raise Invalid(
                "key-expired",
                f"expires_at must lie ahead, not at {ask.expires_at.isoformat()}: it is {now.isoformat()}",
            )
        row = KeyRow(
            id=new_id(), created_at=now, **ask.model_dump(), secret_hash=hash_of(secret), created_by=actor().name
        )
        with self._database.write() as session:
            session.add(row)
            _announce(session, now, event_kinds.KEY_CREATED, row.id, ask.model_dump(mode="json"))
            session.flush()
            return _with_secret(row, secret)

    def page(self, *, after: str | None = None, limit: int = 50) -> Page[Key]:
        """Return one page of keys, newest first."""
        with self._database.read() as session:
            return read_page(session, select(KeyRow), KeyRow, Key.of_row, after=after, limit=limit)

    def all(self) -> list[Key]:
        """Return all keys, the newest first."""
        with self._database.read() as session:
            rows = session.scalars(select(KeyRow).order_by(KeyRow.created_at.desc(), KeyRow.id))
            return [Key.of_row(row) for row in rows]

    def rotate(self, key_id: str, *, grace_s: int = 0) -> NewKey:
        """Replace a key's secret; the old secret is valid for `grace_s` seconds more.

        Raises
        ------
        NotFound, Conflict
            There is no such key, or it is revoked or expired.
        """
        now, secret = self._database.now(), _new_secret()
        with self._database.write() as session:
            row = found(session, KeyRow, "key", key_id, lock=True)
            if not _is_good(row, now):
                raise Conflict("key-ended", f"key {key_id!r} is revoked or expired: make a new one")
            row.previous_hash, row.previous_until = row.secret_hash, now + timedelta(seconds=grace_s)
            row.secret_hash, row.rotated_at = hash_of(secret), now
            _announce(session, now, event_kinds.KEY_ROTATED, key_id, {"name": row.name, "grace_s": grace_s})
            return _with_secret(row, secret)

    def revoke(self, key_id: str) -> Key:
        """End a key at once, and the sessions that it opened; a revoked key does not change.

        Raises
        ------
        NotFound
            There is no such key.
        """
        now = self._database.now()
        with self._database.write() as session:
            row = found(session, KeyRow, "key", key_id, lock=True)
            if row.revoked_at is None:
                row.revoked_at = now
                _announce(session, now, event_kinds.KEY_REVOKED, key_id, {"name": row.name})
            return Key.of_row(row)

    def good(self, secret_hash: str) -> Key | None:
        """Return the valid key that has a secret of this hash, or None."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.scalar(select(KeyRow).where(opened_by(secret_hash, now)))
            return None if row is None or not _is_good(row, now) else Key.of_row(row)

    def used(self, key: Key) -> None:
        """Note that a key was used, at most once a minute."""
        now = self._database.now()
        if key.last_used_at is not None and now - key.last_used_at < USE_STEP:
            return
        with self._database.write() as session:
            session.execute(update(KeyRow).where(KeyRow.id == key.id).values(last_used_at=now))

    def any_good(self) -> bool:
        """Return whether there is a valid key."""
        with self._database.read() as session:
            rows = session.scalars(select(KeyRow).where(KeyRow.revoked_at.is_(None)))
            return any(_is_good(row, self._database.now()) for row in rows)


def _announce(session: Session, now: datetime, what: EventType, key_id: str, decided: Json) -> None:
    """Announce no more than the id to followers, who need not be administrators."""
    announce(session, now, what, "key", key_id, decided=decided)


def opened_by(secret_hash: str | QueryableAttribute[str], now: datetime) -> ColumnElement[bool]:
    """Select keys with a secret of this hash: the present one, or the one before it within its grace."""
    still = and_(KeyRow.previous_hash == secret_hash, KeyRow.previous_until > now)
    return or_(KeyRow.secret_hash == secret_hash, still)


def _is_good(row: KeyRow, now: datetime) -> bool:
    return row.revoked_at is None and (row.expires_at is None or row.expires_at > now)


def _new_secret() -> str:
    return PREFIX + secrets.token_urlsafe(RANDOM_BYTES)


def _with_secret(row: KeyRow, secret: str) -> NewKey:
    return NewKey(**Key.of_row(row).model_dump(), secret=secret)


# A shift and its overtime without a request in between; a display's session lasts as long as its key.
SESSION_LASTS = timedelta(hours=12)
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


class Sessions(StorePart):
    """Store of sessions."""

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
            expires_at=None if lasting else now + SESSION_LASTS,
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
        """Extend a session in use to `SESSION_LASTS` from now; at most one write an hour."""
        now = self._database.now()
        if used.expires_at is None or used.expires_at > now + SESSION_LASTS - RENEWAL_STEP:
            return
        with self._database.write() as session:
            this = SessionRow.secret_hash == used.secret_hash
            session.execute(update(SessionRow).where(this).values(expires_at=now + SESSION_LASTS))

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
