"""Keys: made, found by their secrets, rotated, revoked. Only the SHA-256 of a secret is stored.

A secret has 256 random bits: nobody can try them all, so a slow hash would protect nothing and delay every request.
"""

import hashlib
import secrets
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, and_, or_, select, update
from sqlalchemy.orm import QueryableAttribute, Session

from sawmill_platform.acting import actor
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.keys import Key, KeyRequest, NewKey
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import found, new_id, read_page
from sawmill_platform.database.tables import Json, KeyRow
from sawmill_platform.errors import Conflict, Invalid
from sawmill_platform.ledger.events import announce

# Prefix by which search programs for leaked secrets recognise a secret.
PREFIX = "sawmill_"
RANDOM_BYTES = 32
# Precision of `last_used_at`: each step is a write.
USE_STEP = timedelta(minutes=1)


def hash_of(secret: str) -> str:
    """Return the hash of a secret, which is stored."""
    return hashlib.sha256(secret.encode()).hexdigest()


class KeyStore:
    """Store of keys; every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

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
            return _any_good(session, self._database.now())


def _announce(session: Session, now: datetime, what: EventType, key_id: str, decided: Json) -> None:
    """Announce no more than the id to followers, who need not be administrators."""
    announce(session, now, what, "key", key_id, decided=decided)


def _any_good(session: Session, now: datetime) -> bool:
    return any(_is_good(row, now) for row in session.scalars(select(KeyRow).where(KeyRow.revoked_at.is_(None))))


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
