"""What is to be sent to webhooks: the table of events itself, behind the number with which each webhook is done.

Nothing is copied, so an event cannot be there and its message not. A webhook's number moves on in the transaction that
notes a delivery: who is killed between sending and noting sends again, with the same id.
"""

import hashlib
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.webhooks import DeliveryState
from sawmill_platform.database.database import Database
from sawmill_platform.database.paging import new_id
from sawmill_platform.database.tables import DeliveryRow, SenderRow, WebhookRow
from sawmill_platform.ledger.event_reader import EventReader, read_event
from sawmill_platform.ledger.events import announce
from sawmill_platform.webhooks.webhook_store import read_events, secret_of

# How long another process waits for one that was killed; each renews it after half of that.
LEASE = timedelta(seconds=30)
_THE_ROW = 1
_BATCH = 100
# No wait is longer: what lies farther ahead is of a clock that was put back.
_LONGEST_WAIT = timedelta(hours=36)


@dataclass(frozen=True)
class Pending:
    """A webhook and the events that it is sent next.

    Attributes
    ----------
    webhook_id, url : str
        The webhook.
    secrets : tuple of str
        With which its messages are signed.
    failures : int
        Attempts at the first event that have failed.
    events : list of Event
        The oldest first.
    """

    webhook_id: str
    url: str
    secrets: tuple[str, ...]
    failures: int
    events: list[Event]


@dataclass(frozen=True)
class Attempt:
    """The outcome of one attempt.

    Attributes
    ----------
    status : int or None
        Of the answer; None: there was none.
    reason : str or None
        Why it failed; None: it did not.
    wait_s : float or None
        Until the next one; None: there is none, the webhook is paused.
    """

    status: int | None
    reason: str | None = None
    wait_s: float | None = None


class Outbox:
    """Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._holder = new_id()  # by which this process holds the right to send
        # Of webhooks that want none of the events so far: where they stood, and through which event that is known.
        self._without: dict[str, tuple[int, list[str], int]] = {}

    def reader(self) -> EventReader:
        """Tells through which number all events are written."""
        return EventReader(self._database)

    def now(self) -> datetime:
        """The time by which attempts are made."""
        return self._database.now()

    def is_wanted(self) -> bool:
        """Whether any webhook is enabled."""
        with self._database.read() as session:
            return session.scalar(select(WebhookRow.id).where(WebhookRow.enabled).limit(1)) is not None

    def hold(self) -> bool:
        """Whether this process may send from now on, for the time of a lease; no other one does meanwhile."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(SenderRow, _THE_ROW)
            if row is not None and _holds(row, now):
                if row.holder != self._holder:
                    return False
                if row.held_until - now > LEASE / 2:
                    return True
        with self._database.write() as session:
            row = session.get(SenderRow, _THE_ROW, with_for_update=True)
            if row is None:
                session.add(SenderRow(number=_THE_ROW, holder=self._holder, held_until=now + LEASE))
                return True
            if row.holder != self._holder and _holds(row, now):
                return False
            row.holder, row.held_until = self._holder, now + LEASE
            return True

    def release(self) -> None:
        """Let another process send at once."""
        mine = SenderRow.number == _THE_ROW, SenderRow.holder == self._holder
        with self._database.write() as session:
            session.execute(update(SenderRow).where(*mine).values(held_until=self._database.now()))

    def due(self, through: int) -> list[str]:
        """The webhooks to which something can be sent now.

        Parameters
        ----------
        through
            Number of the last event that counts: `EventReader` tells through which one all of them are written.
        """
        with self._database.read() as session:
            rows = session.scalars(select(WebhookRow).where(WebhookRow.enabled).order_by(WebhookRow.id)).all()
            now = self._database.now()
            return [row.id for row in rows if _is_due(row, now) and self._has_events(session, row, through)]

    def _has_events(self, session: Session, row: WebhookRow, through: int) -> bool:
        """Whether any is to be sent; asked again only once there are new ones: nothing appears among earlier ones."""
        looked_through = row.after, row.events, through
        if self._without.get(row.id) == looked_through:
            return False
        if read_events(session, row, through, 1):
            return True
        self._without[row.id] = looked_through
        return False

    def pending(self, webhook_id: str, through: int) -> Pending | None:
        """What a webhook is sent next; None: nothing, or not now. `through` as for `due`."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(WebhookRow, webhook_id)
            if row is None or not row.enabled or not _is_due(row, now):
                return None
            events = [read_event(event) for event in read_events(session, row, through, _BATCH)]
            return Pending(row.id, row.url, secret_of(row, now), row.failures, events) if events else None

    def note(self, pending: Pending, event: Event, attempt: Attempt) -> bool:
        """Enter an attempt's outcome; the last one that fails pauses the webhook and announces it.

        Returns
        -------
        bool
            Whether the next event may follow at once: it was delivered, and nobody has changed the webhook meanwhile.
        """
        with self._database.write() as session:
            row = session.get(WebhookRow, pending.webhook_id, with_for_update=True)
            if row is None:
                return False
            now = self._database.now()
            _enter(session, row, event, attempt, now)
            unchanged = row.enabled and row.url == pending.url and row.secret == pending.secrets[0]
            # Somebody who moved it back wants the events again, and somebody who moved it on wants none of them.
            is_next = row.after < event.number and not read_events(session, row, event.number - 1, 1)
            if attempt.reason is None:
                row.last_success_at, row.delivered = now, row.delivered + 1
                if is_next:
                    row.after, row.failures, row.next_attempt_at = event.number, 0, None
                return unchanged and is_next
            row.last_failure_at, row.last_failure, row.failed = now, attempt.reason, row.failed + 1
            if unchanged and is_next:
                _fail(session, row, attempt, now)
            return False


def message_id(webhook_id: str, event: Event) -> str:
    """The id of an event's message to a webhook: the same in every attempt, and another after a database was put back.

    Numbers alone would come again then.
    """
    what = f"{webhook_id} {event.number} {event.at.isoformat()} {event.what} {event.subject_id}"
    return f"msg_{hashlib.sha256(what.encode()).hexdigest()[:32]}"


def _holds(row: SenderRow, now: datetime) -> bool:
    """Whether its time has not run out; one that lies farther ahead is of a clock that was put back."""
    return now < row.held_until <= now + LEASE


def _is_due(row: WebhookRow, now: datetime) -> bool:
    return row.next_attempt_at is None or not now < row.next_attempt_at <= now + _LONGEST_WAIT


def _fail(session: Session, row: WebhookRow, attempt: Attempt, now: datetime) -> None:
    row.failures += 1
    if attempt.wait_s is not None:
        row.next_attempt_at = now + timedelta(seconds=attempt.wait_s)
        return
    row.enabled, row.paused, row.next_attempt_at = False, True, None
    detail = {"reason": attempt.reason, "failures": row.failures}
    announce(session, now, event_kinds.WEBHOOK_PAUSED, "webhook", row.id, detail=detail)


def _enter(session: Session, row: WebhookRow, event: Event, attempt: Attempt, now: datetime) -> None:
    mine = DeliveryRow.webhook_id == row.id, DeliveryRow.event_number == event.number
    entry = session.scalar(select(DeliveryRow).where(*mine))
    identifier = message_id(row.id, event)
    if entry is None or entry.message_id != identifier:
        if entry is not None:  # of a database that was put back
            session.delete(entry)
            session.flush()
        entry = DeliveryRow(webhook_id=row.id, event_number=event.number, message_id=identifier)
        entry.what, entry.first_at, entry.attempts = event.what, now, 0
        session.add(entry)
    entry.attempts += 1
    entry.last_at, entry.status, entry.reason = now, attempt.status, attempt.reason
    if attempt.reason is None:
        entry.state = DeliveryState.DELIVERED
    else:
        entry.state = DeliveryState.FAILED if attempt.wait_s is None else DeliveryState.RETRYING
