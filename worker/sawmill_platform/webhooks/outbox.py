"""Events to be sent to webhooks: the rows of the event table after the number that each webhook has reached.

Events are not copied, so an event cannot exist without its message. A webhook's number advances in the transaction that
notes a delivery: a process that is killed between sending and noting sends again, with the same id.
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
from sawmill_platform.ledger.event_reader import EventReader
from sawmill_platform.ledger.events import announce
from sawmill_platform.webhooks.webhook_store import read_events, secret_of

# Time for which a process waits after another one was killed; a holder renews its lease after half of the time.
LEASE = timedelta(seconds=30)
_THE_ROW = 1
_BATCH = 100
# Longest wait: a time farther ahead is from a clock that was put back.
_LONGEST_WAIT = timedelta(hours=36)


@dataclass(frozen=True)
class Pending:
    """A webhook and the events to send to it next."""

    # webhook_id, url: id and URL of the webhook.
    webhook_id: str
    url: str
    secrets: tuple[str, ...]  # secrets that sign the webhook's messages
    failures: int  # attempts at the first event that have failed
    events: list[Event]  # events, the oldest first


@dataclass(frozen=True)
class DeliveryAttempt:
    """The outcome of one attempt."""

    status: int | None  # HTTP status of the answer; None: there was no answer
    reason: str | None = None  # reason of the failure; None: the attempt succeeded
    wait_s: float | None = None  # seconds until the next attempt; None: there is none, and the webhook is paused


class Outbox:
    """Store of the events to send; every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._holder = new_id()  # the id under which this process holds the right to send
        # Webhooks without an event so far: their number and event names, and the event number through which that is
        # certain.
        self._without: dict[str, tuple[int, list[str], int]] = {}

    def reader(self) -> EventReader:
        """Return a reader, which has the number through which all events are written."""
        return EventReader(self._database)

    def now(self) -> datetime:
        """Return the time for attempts."""
        return self._database.now()

    def is_wanted(self) -> bool:
        """Return whether any webhook is enabled."""
        with self._database.read() as session:
            return session.scalar(select(WebhookRow.id).where(WebhookRow.enabled).limit(1)) is not None

    def hold(self) -> bool:
        """Claim the right to send, exclusive for the time of a lease; return whether this process holds it."""
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
        """Release the right to send at once, for another process."""
        mine = SenderRow.number == _THE_ROW, SenderRow.holder == self._holder
        with self._database.write() as session:
            session.execute(update(SenderRow).where(*mine).values(held_until=self._database.now()))

    def due(self, through: int) -> list[str]:
        """Return the webhooks to which an event can be sent now.

        Parameters
        ----------
        through
            Number of the last event that counts: `EventReader` has the number through which all are written.
        """
        with self._database.read() as session:
            rows = session.scalars(select(WebhookRow).where(WebhookRow.enabled).order_by(WebhookRow.id)).all()
            now = self._database.now()
            return [row.id for row in rows if _is_due(row, now) and self._has_events(session, row, through)]

    def _has_events(self, session: Session, row: WebhookRow, through: int) -> bool:
        """Return whether any event is to be sent.

        The query is repeated only after new events: no event is added among earlier ones.
        """
        looked_through = row.after, row.events, through
        if self._without.get(row.id) == looked_through:
            return False
        if read_events(session, row, through, 1):
            return True
        self._without[row.id] = looked_through
        return False

    def pending(self, webhook_id: str, through: int) -> Pending | None:
        """Return the next events of a webhook; None: there are none, or none now. `through` is as for `due`."""
        now = self._database.now()
        with self._database.read() as session:
            row = session.get(WebhookRow, webhook_id)
            if row is None or not row.enabled or not _is_due(row, now):
                return None
            events = [Event.of_row(event) for event in read_events(session, row, through, _BATCH)]
            return Pending(row.id, row.url, secret_of(row, now), row.failures, events) if events else None

    def note(self, pending: Pending, event: Event, attempt: DeliveryAttempt) -> bool:
        """Enter an attempt's outcome; the last one that fails pauses the webhook and announces that.

        Returns
        -------
        bool
            Whether the next event may follow at once: this one was delivered, and nobody has changed the webhook since.
        """
        with self._database.write() as session:
            row = session.get(WebhookRow, pending.webhook_id, with_for_update=True)
            if row is None:
                return False
            now = self._database.now()
            mine = DeliveryRow.webhook_id == row.id, DeliveryRow.event_number == event.number
            entry = session.scalar(select(DeliveryRow).where(*mine))
            identifier = message_id(row.id, event)
            if entry is None or entry.message_id != identifier:
                if entry is not None:  # from a database that was restored
                    session.delete(entry)
                    session.flush()
                entry = DeliveryRow(webhook_id=row.id, event_number=event.number, message_id=identifier)
                entry.type, entry.first_at, entry.attempts = event.type, now, 0
                session.add(entry)
            entry.attempts += 1
            entry.last_at, entry.status, entry.reason = now, attempt.status, attempt.reason
            if attempt.reason is None:
                entry.state = DeliveryState.DELIVERED
            else:
                entry.state = DeliveryState.FAILED if attempt.wait_s is None else DeliveryState.RETRYING
            unchanged = row.enabled and row.url == pending.url and row.secret == pending.secrets[0]
            # A user who moved the number back wants the events again, and one who moved it forward wants none of them.
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
    """Return the id of an event's message to a webhook: equal in all attempts, and different after a restore.

    Numbers alone would repeat after a restore.
    """
    what = f"{webhook_id} {event.number} {event.at.isoformat()} {event.type} {event.subject_id}"
    return f"msg_{hashlib.sha256(what.encode()).hexdigest()[:32]}"


def _holds(row: SenderRow, now: datetime) -> bool:
    """Return whether the lease is valid; one that ends farther ahead is from a clock that was put back."""
    return now < row.held_until <= now + LEASE


def _is_due(row: WebhookRow, now: datetime) -> bool:
    return row.next_attempt_at is None or not now < row.next_attempt_at <= now + _LONGEST_WAIT


def _fail(session: Session, row: WebhookRow, attempt: DeliveryAttempt, now: datetime) -> None:
    row.failures += 1
    if attempt.wait_s is not None:
        row.next_attempt_at = now + timedelta(seconds=attempt.wait_s)
        return
    row.enabled, row.paused, row.next_attempt_at = False, True, None
    detail = {"reason": attempt.reason, "failures": row.failures}
    announce(session, now, event_kinds.WEBHOOK_PAUSED, "webhook", row.id, detail=detail)
