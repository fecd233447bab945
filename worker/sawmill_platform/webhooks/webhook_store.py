"""Webhooks: made, changed, listed. Their events are rows of the event table (`webhooks/outbox.py`).

A secret is stored in plain text: each message is signed with it.
"""

import secrets
from base64 import b64encode
from collections.abc import Sequence
from datetime import datetime, timedelta
from functools import partial

from sqlalchemy import ColumnElement, delete, func, select
from sqlalchemy.orm import Session

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.webhooks import (
    Delivery,
    NewWebhook,
    Webhook,
    WebhookRequest,
    WebhookState,
    WebhookTest,
    kinds_of,
)
from sawmill_platform.database.database import StorePart
from sawmill_platform.database.paging import Check, accept_any, found, new_id, read_numbered_page, read_page
from sawmill_platform.database.tables import DeliveryRow, EventRow, WebhookRow
from sawmill_platform.errors import Conflict
from sawmill_platform.ledger.audit import changed
from sawmill_platform.ledger.event_reader import newest_number
from sawmill_platform.ledger.events import announce

PREFIX = "whsec_"
RANDOM_BYTES = 32  # the specification has 24 to 64
MOST = 50
# Most waiting events that are counted: after a year without contact, a list of webhooks must not count all of them.
COUNTED = 10_000
# Time for which deliveries are kept after the last attempt.
KEPT = timedelta(days=7)
_FORGOTTEN_AT_ONCE = 1000
_AUDITED = ("url", "description", "events", "enabled")


def secret_of(row: WebhookRow, now: datetime) -> tuple[str, ...]:
    """Return the secrets that sign a webhook's messages now: its own, and the one before within its grace."""
    if row.previous_secret is None or row.previous_secret_until is None or row.previous_secret_until <= now:
        return (row.secret,)
    return row.secret, row.previous_secret


def wanted_by(row: WebhookRow) -> ColumnElement[bool]:
    """Select the events that are to be sent to a webhook and have not been sent."""
    behind = EventRow.number > row.after
    return behind if "*" in row.events else behind & EventRow.type.in_(sorted(kinds_of(row.events)))


class WebhookStore(StorePart):
    """Store of webhooks."""

    def create(self, ask: WebhookRequest, *, webhook_id: str | None = None) -> NewWebhook:
        """Add a webhook.

        Raises
        ------
        Conflict
            There are too many; the code is `too-many-webhooks`.
        """
        now = self._database.now()
        with self._database.write() as session:
            if (session.scalar(select(func.count()).select_from(WebhookRow)) or 0) >= MOST:
                raise Conflict(
                    "too-many-webhooks", f"there are {MOST} webhooks already, and there can be no more: delete one"
                )
            row = WebhookRow(id=webhook_id or new_id(), created_at=now, secret=_new_secret())
            _describe(session, row, ask)
            announce(session, now, event_kinds.WEBHOOK_CREATED, "webhook", row.id, decided=_audited(row))
            session.flush()
            newest = newest_number(session)
            row.after = newest if ask.after is None else min(ask.after, newest)
            session.add(row)
            session.flush()
            return _with_secret(session, row)

    def page(self, *, after: str | None = None, limit: int = 50) -> Page[Webhook]:
        """Return one page of webhooks, newest first."""
        with self._database.read() as session:
            read = partial(read_webhook, session)
            return read_page(session, select(WebhookRow), WebhookRow, read, after=after, limit=limit)

    def all(self) -> list[Webhook]:
        """Return all webhooks, the newest first."""
        with self._database.read() as session:
            rows = session.scalars(select(WebhookRow).order_by(WebhookRow.created_at.desc(), WebhookRow.id))
            return [read_webhook(session, row) for row in rows.all()]

    def get(self, webhook_id: str) -> Webhook:
        """Return one webhook, or raise `NotFound`."""
        with self._database.read() as session:
            return read_webhook(session, found(session, WebhookRow, "webhook", webhook_id))

    def signing(self, webhook_id: str) -> tuple[Webhook, tuple[str, ...], datetime]:
        """Return one webhook, its secrets and the time for which they sign, or raise `NotFound`."""
        with self._database.read() as session:
            row, now = found(session, WebhookRow, "webhook", webhook_id), self._database.now()
            return read_webhook(session, row), secret_of(row, now), now

    def update(self, webhook_id: str, ask: WebhookRequest, *, check: Check[Webhook] = accept_any) -> Webhook:
        """Replace a webhook; if it is enabled, the next attempt is made at once."""
        with self._database.write() as session:
            row = found(session, WebhookRow, "webhook", webhook_id, lock=True)
            check(read_webhook(session, row))
            _replace(session, self._database.now(), row, ask)
            return read_webhook(session, row)

    def enable(self, webhook_id: str, *, enabled: bool) -> None:
        """Enable or disable a webhook, or raise `NotFound`."""
        with self._database.write() as session:
            row = found(session, WebhookRow, "webhook", webhook_id, lock=True)
            ask = WebhookRequest(url=row.url, description=row.description, events=row.events, enabled=enabled)
            _replace(session, self._database.now(), row, ask)

    def rotate(self, webhook_id: str, *, grace_s: int) -> NewWebhook:
        """Replace a webhook's secret, or raise `NotFound`; the old one signs messages too for `grace_s` seconds."""
        now = self._database.now()
        with self._database.write() as session:
            row = found(session, WebhookRow, "webhook", webhook_id, lock=True)
            row.previous_secret, row.previous_secret_until = row.secret, now + timedelta(seconds=grace_s)
            row.secret = _new_secret()
            announce(session, now, event_kinds.WEBHOOK_ROTATED, "webhook", webhook_id, decided={"grace_s": grace_s})
            return _with_secret(session, row)

    def note_test(self, test: WebhookTest) -> WebhookTest:
        """Enter that somebody sent a test, and why it was not delivered; the webhook does not change."""
        now, detail = self._database.now(), {} if test.reason is None else {"reason": test.reason}
        with self._database.write() as session:
            announce(
                session, now, event_kinds.WEBHOOK_TESTED, "webhook", test.webhook_id, detail=detail, decided=detail
            )
        return test

    def delete(self, webhook_id: str) -> None:
        """Remove a webhook and its list of deliveries, or raise `NotFound`."""
        with self._database.write() as session:
            row, now = found(session, WebhookRow, "webhook", webhook_id, lock=True), self._database.now()
            announce(session, now, event_kinds.WEBHOOK_DELETED, "webhook", webhook_id, decided=_audited(row))
            session.delete(row)

    def deliveries(self, webhook_id: str, *, after: str | None = None, limit: int = 50) -> Page[Delivery]:
        """Return a page of a webhook's deliveries, the newest first.

        Raises
        ------
        NotFound, Invalid
            There is no such webhook, or `after` is not a cursor from an earlier page.
        """
        statement = select(DeliveryRow).where(DeliveryRow.webhook_id == webhook_id)
        with self._database.read() as session:
            found(session, WebhookRow, "webhook", webhook_id)
            return read_numbered_page(session, statement, DeliveryRow.number, Delivery.of_row, after=after, limit=limit)

    def forget_deliveries(self) -> None:
        """Remove entries of deliveries that are older than `KEPT`, some at a time."""
        is_old = DeliveryRow.last_at < self._database.now() - KEPT
        with self._database.read() as session:
            numbers = session.scalars(select(DeliveryRow.number).where(is_old).limit(_FORGOTTEN_AT_ONCE)).all()
        if numbers:
            with self._database.write() as session:  # another attempt may have been noted since
                session.execute(delete(DeliveryRow).where(DeliveryRow.number.in_(numbers), is_old))


def _replace(session: Session, now: datetime, row: WebhookRow, ask: WebhookRequest) -> None:
    before = _audited(row) | {"after": row.after}
    _describe(session, row, ask)
    row.paused, row.failures, row.next_attempt_at = False, 0, None
    after = _audited(row) | {"after": row.after}
    announce(session, now, event_kinds.WEBHOOK_CHANGED, "webhook", row.id, decided=changed(before, after))
    session.flush()


def _describe(session: Session, row: WebhookRow, ask: WebhookRequest) -> None:
    row.url, row.description, row.events, row.enabled = ask.url, ask.description, ask.events, ask.enabled
    if ask.after is not None:
        row.after = min(ask.after, newest_number(session))  # later events are not skipped


def _audited(row: WebhookRow) -> dict[str, object]:
    return {name: getattr(row, name) for name in _AUDITED}


def _new_secret() -> str:
    return PREFIX + b64encode(secrets.token_bytes(RANDOM_BYTES)).decode()


def read_webhook(session: Session, row: WebhookRow) -> Webhook:
    """Return the webhook of a row in its present state, with its waiting events counted."""
    oldest = session.scalar(select(EventRow.at).where(wanted_by(row)).order_by(EventRow.number).limit(1))
    some = select(EventRow.number).where(wanted_by(row)).limit(COUNTED).subquery()
    waiting = session.scalar(select(func.count()).select_from(some))
    if row.enabled:
        state = WebhookState.RETRYING if row.failures else WebhookState.ACTIVE
    else:
        state = WebhookState.PAUSED if row.paused else WebhookState.DISABLED
    return Webhook.of_row(row, state=state, waiting=waiting, waiting_since=oldest)


def _with_secret(session: Session, row: WebhookRow) -> NewWebhook:
    return NewWebhook(**read_webhook(session, row).model_dump(), secret=row.secret)


def read_events(session: Session, row: WebhookRow, through: int, limit: int) -> Sequence[EventRow]:
    """Return the next events of a webhook, the oldest first, through a number at most."""
    wanted = select(EventRow).where(wanted_by(row), EventRow.number <= through)
    return session.scalars(wanted.order_by(EventRow.number).limit(limit)).all()
