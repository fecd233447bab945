"""Answers to requests that may be repeated, kept in the transaction of the request's changes (migration 0010).

A key is claimed before any change, so of many requests at once all except one wait for the first one's commit and find
its answer. When the change is refused, or the process is killed, the claim is rolled back with the rest.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import TypeVar

from sqlalchemy import ColumnElement, delete, select
from sqlalchemy.dialects.postgresql import insert as insert_on_postgresql
from sqlalchemy.dialects.sqlite import insert as insert_on_sqlite
from sqlalchemy.orm import Session

from sawmill_platform.database.database import StorePart
from sawmill_platform.database.tables import RepeatRow
from sawmill_platform.errors import Invalid

KEPT = timedelta(hours=48)

Made = TypeVar("Made")


@dataclass(frozen=True)
class KeyedRequest:
    """A request that may be repeated."""

    caller: str  # the client, whose keys are separate from other clients' keys
    key: str  # the client's name of the request
    request_sha256: str  # digest of everything that identifies the request, except a file
    file_sha256: str | None = None  # digest of the uploaded file; null: no file was sent


@dataclass(frozen=True)
class KeptAnswer:
    """The answer to a request."""

    status: int  # HTTP status
    headers: dict[str, str]  # headers that the route has set
    body: str  # JSON
    whole: bool = True  # False: the body had a secret, which is not kept


@dataclass(frozen=True)
class KeptRequest:
    """A request that has been answered."""

    request: KeyedRequest
    answered_at: datetime
    answer: KeptAnswer

    def answer_to(self, again: KeyedRequest) -> KeptAnswer:
        """Return the answer if the repeated request is the same request."""
        if again == self.request:
            return self.answer
        raise Invalid(
            "idempotency-key-reused",
            f"Idempotency-Key {again.key!r} is that of another request, answered at "
            f"{self.answered_at.isoformat(timespec='seconds')}: send that one as it was, or take a new key for "
            "this one",
        )


class Repeats(StorePart):
    """Store of answers."""

    def once(
        self, request: KeyedRequest, make: Callable[[], Made], kept_as: Callable[[Made], KeptAnswer]
    ) -> Made | KeptAnswer:
        """Make a change and keep the answer, in one transaction with all that this thread writes in between.

        Parameters
        ----------
        request
            Request with its key.
        make
            Function that does the requested work. It is not called when the request has been answered before.
        kept_as
            Function from the result to the answer that repeated requests get.

        Returns
        -------
        Made or KeptAnswer
            The result, or the answer from before.

        Raises
        ------
        Invalid
            The key belongs to another request.
        """
        with self._database.write_as_one() as session:
            # Claim the key if it is new; other requests with it wait for the end of the transaction.
            now = self._database.now()
            session.execute(delete(RepeatRow).where(_named(request), _old(now)))
            insert = insert_on_sqlite if session.get_bind().dialect.name == "sqlite" else insert_on_postgresql
            claimed = insert(RepeatRow).values(asdict(request) | {"created_at": now}).on_conflict_do_nothing()
            if session.scalar(claimed.returning(RepeatRow.key)) is None:
                return read_kept(_row(session, request)).answer_to(request)
            made = make()
            _row(session, request).answer = asdict(kept_as(made))
            return made

    def find(self, request: KeyedRequest) -> KeptRequest | None:
        """Return the answered request with this request's key, or None."""
        with self._database.read() as session:
            row = session.scalar(select(RepeatRow).where(_named(request), ~_old(self._database.now())))
            return None if row is None else read_kept(row)

    def forget_old(self) -> None:
        """Remove the answers whose time is over."""
        old = _old(self._database.now())
        with self._database.read() as session:
            if session.scalar(select(RepeatRow.key).where(old).limit(1)) is None:
                return
        with self._database.write() as session:
            session.execute(delete(RepeatRow).where(old))


def _named(request: KeyedRequest) -> ColumnElement[bool]:
    return (RepeatRow.caller == request.caller) & (RepeatRow.key == request.key)


def _old(now: datetime) -> ColumnElement[bool]:
    return RepeatRow.created_at <= now - KEPT


def _row(session: Session, request: KeyedRequest) -> RepeatRow:
    return session.get_one(RepeatRow, (request.caller, request.key))


def read_kept(row: RepeatRow) -> KeptRequest:
    """Return the answered request of a row."""
    request = KeyedRequest(row.caller, row.key, row.request_sha256, row.file_sha256)
    assert row.answer is not None  # noqa: S101 - written before the claim is committed
    return KeptRequest(request, row.created_at, KeptAnswer(**row.answer))
