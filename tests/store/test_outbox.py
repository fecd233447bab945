"""What is sent to webhooks and in which order, what is noted of it, and who sends; on both databases."""

from dataclasses import replace
from datetime import timedelta

import pytest
from emptied_databases import postgresql_alone
from pydantic import ValidationError
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from sawmill_contracts import mill_events
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.webhooks import Destination, WebhookRequest, WebhookTest, destination_of, kinds_of
from sawmill_platform.database.tables import DeliveryRow
from sawmill_platform.errors import Conflict, NotFound
from sawmill_platform.ledger.events import announce
from sawmill_platform.webhooks.outbox import LEASE, DeliveryAttempt, message_id
from sawmill_platform.webhooks.webhook_store import KEPT, MOST

pytestmark = pytest.mark.clocked

URL = "https://alarms.mill.example/sawmill"
DELIVERED = DeliveryAttempt(200)


@pytest.fixture
def outbox(store):
    return store.outbox()


def happen(store, *kinds: EventType) -> list[int]:
    """Write events in one transaction each; their numbers."""
    numbers = []
    for kind in kinds:
        with store.database.write() as session:
            announce(session, store.database.now(), kind, "scanner", "line-2", group_id="line-2")
        numbers.append(store.events.newest_number())
    return numbers


def waiting(outbox, webhook, through: int = 10**6) -> list[int]:
    pending = outbox.pending(webhook.id, through)
    return [] if pending is None else [event.number for event in pending.events]


def deliver(outbox, webhook, attempt: DeliveryAttempt = DELIVERED) -> bool:
    pending = outbox.pending(webhook.id, 10**6)
    return outbox.note(pending, pending.events[0], attempt)


def failed(wait_s: float | None = 5.0) -> DeliveryAttempt:
    return DeliveryAttempt(500, "it answered 500", wait_s)


def test_a_webhook_is_sent_what_it_asked_for_in_order_from_now_on(store, outbox):
    happen(store, mill_events.ALARM_OPENED)
    alarms = store.webhooks.create(WebhookRequest(url=URL))
    everything = store.webhooks.create(WebhookRequest(url=URL, events=["*"]))
    disabled = store.webhooks.create(WebhookRequest(url=URL, enabled=False))
    kinds = (mill_events.ALARM_OPENED, mill_events.SCANNER_CHANGED, mill_events.ALARM_CLOSED)
    first, changed, last = happen(store, *kinds)
    assert waiting(outbox, alarms) == [first, last]
    assert waiting(outbox, everything)[-3:] == [first, changed, last]
    assert waiting(outbox, disabled) == []
    assert (store.webhooks.get(alarms.id).waiting, store.webhooks.get(disabled.id).waiting) == (2, 2)
    assert waiting(outbox, alarms, through=first) == [first]
    assert outbox.due(first - 1) == [everything.id]
    assert outbox.due(first) == sorted([alarms.id, everything.id])
    assert [deliver(outbox, alarms), deliver(outbox, alarms)] == [True, True]
    now = store.webhooks.get(alarms.id)
    assert (now.after, now.waiting, now.waiting_since, now.state) == (last, 0, None, "active")


def test_a_webhook_that_is_moved_or_asks_for_more_is_looked_at_again(store, outbox):
    assert not outbox.is_wanted()
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    assert outbox.is_wanted()
    [first, refused] = happen(store, mill_events.ALARM_OPENED, mill_events.SCAN_REFUSED)
    deliver(outbox, webhook)
    assert [outbox.due(refused), outbox.due(refused)] == [[], []]
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, events=["scan-refused"]))
    assert outbox.due(refused) == [webhook.id]
    store.webhooks.update(webhook.id, WebhookRequest(url=URL))
    assert outbox.due(refused) == []
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, after=first - 1))
    assert outbox.due(refused) == [webhook.id]
    deliver(outbox, webhook)
    assert outbox.due(refused) == []
    [opened] = happen(store, mill_events.ALARM_OPENED)
    assert outbox.due(opened) == [webhook.id]
    store.webhooks.enable(webhook.id, enabled=False)
    assert not outbox.is_wanted()


@pytest.mark.dialect
def test_a_failure_holds_back_what_follows_until_it_is_delivered(store, outbox, clock):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    first, second = happen(store, mill_events.ALARM_OPENED, mill_events.ALARM_CLOSED)
    assert deliver(outbox, webhook, failed(60.0)) is False
    assert outbox.due(second) == []
    stands = store.webhooks.get(webhook.id)
    assert (stands.state, stands.failures, stands.last_failure) == ("retrying", 1, "it answered 500")
    assert stands.next_attempt_at == clock() + timedelta(seconds=60)
    clock.advance(seconds=61)
    assert waiting(outbox, webhook) == [first, second]
    assert deliver(outbox, webhook) is True
    entries = store.webhooks.deliveries(webhook.id).items
    assert [(entry.event_number, entry.state, entry.attempts) for entry in entries] == [(first, "delivered", 2)]
    assert store.webhooks.get(webhook.id).failures == 0
    clock.advance(hours=-12)  # a clock that is put back makes nobody wait for it
    deliver(outbox, webhook, failed(60.0))
    clock.advance(hours=-48)
    assert waiting(outbox, webhook) == [second]


def test_events_are_sent_again_or_passed_over_when_somebody_says_so(store, outbox):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    first, second, third = happen(store, *[mill_events.ALARM_OPENED] * 3)
    deliver(outbox, webhook)
    sent = store.webhooks.deliveries(webhook.id).items[0].message_id
    pending = outbox.pending(webhook.id, 10**6)
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, after=first - 1))
    assert outbox.note(pending, pending.events[0], DELIVERED) is False  # that was sent before somebody moved it back
    assert waiting(outbox, webhook) == [first, second, third]
    deliver(outbox, webhook)
    [again] = [entry for entry in store.webhooks.deliveries(webhook.id).items if entry.event_number == first]
    assert (again.message_id, again.attempts) == (sent, 2)
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, after=second))
    assert waiting(outbox, webhook) == [third]
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, after=2**31 - 1))
    assert waiting(outbox, webhook) == []
    later = happen(store, mill_events.ALARM_OPENED)
    assert waiting(outbox, webhook) == later


def test_a_change_counts_from_the_next_event_on(store, outbox):
    for name, change in {
        "pause": lambda identifier: store.webhooks.enable(identifier, enabled=False),
        "move": lambda identifier: store.webhooks.update(identifier, WebhookRequest(url="https://other.mill.example/")),
        "rotate": lambda identifier: store.webhooks.rotate(identifier, grace_s=0),
        "delete": store.webhooks.delete,
    }.items():
        webhook = store.webhooks.create(WebhookRequest(url=URL))
        happen(store, *[mill_events.ALARM_OPENED] * 2)
        pending = outbox.pending(webhook.id, 10**6)
        change(webhook.id)
        assert outbox.note(pending, pending.events[0], DELIVERED) is False
        assert name == "delete" or store.webhooks.get(webhook.id).after == pending.events[0].number


@pytest.mark.dialect
def test_one_process_sends_at_a_time(store, clock):
    mine, other = store.outbox(), store.outbox()
    assert [mine.hold(), other.hold(), mine.hold()] == [True, False, True]
    clock.advance(seconds=0.6 * LEASE.total_seconds())
    assert mine.hold()  # and renews it
    clock.advance(seconds=0.6 * LEASE.total_seconds())
    assert not other.hold()
    clock.advance(seconds=LEASE.total_seconds())  # killed
    assert [other.hold(), mine.hold()] == [True, False]
    other.release()
    assert [mine.hold(), other.hold()] == [True, False]
    clock.advance(hours=-1)  # a clock that is put back does not lend it for an hour
    assert other.hold()


@pytest.mark.dialect
def test_what_was_delivered_is_forgotten_after_a_week(store, outbox, clock):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    happen(store, *[mill_events.ALARM_OPENED] * 2)
    deliver(outbox, webhook)
    clock.advance(days=KEPT.days - 1)
    deliver(outbox, webhook)
    clock.advance(days=1, seconds=1)
    store.webhooks.forget_deliveries()
    assert len(store.webhooks.deliveries(webhook.id).items) == 1
    store.webhooks.delete(webhook.id)
    with store.database.read() as session:
        assert session.scalar(select(func.count()).select_from(DeliveryRow)) == 0


def test_lists_turn_pages_and_every_change_is_audited(store, outbox):
    webhook = store.webhooks.create(WebhookRequest(url=URL, description="office"))
    numbers = happen(store, *[mill_events.ALARM_OPENED] * 3)
    while waiting(outbox, webhook):
        deliver(outbox, webhook)
    page = store.webhooks.deliveries(webhook.id, limit=2)
    rest = store.webhooks.deliveries(webhook.id, limit=2, after=page.next)
    assert [entry.event_number for entry in (*page.items, *rest.items)] == numbers[::-1]
    store.webhooks.update(webhook.id, WebhookRequest(url=URL, events=["failed"]))
    test = WebhookTest(delivered=False, message_id="msg_1", webhook_id=webhook.id, status=500, reason="it answered 500")
    assert store.webhooks.note_test(test) == test
    store.webhooks.rotate(webhook.id, grace_s=0)
    store.webhooks.delete(webhook.id)
    changes = [event_kinds.WEBHOOK_CREATED, event_kinds.WEBHOOK_CHANGED, event_kinds.WEBHOOK_TESTED]
    changes += [event_kinds.WEBHOOK_ROTATED, event_kinds.WEBHOOK_DELETED]
    assert [entry.action for entry in store.audit.all()] == changes
    for call in (store.webhooks.get, store.webhooks.deliveries, store.webhooks.delete, store.webhooks.signing):
        with pytest.raises(NotFound):
            call(webhook.id)
    for _ in range(MOST):
        store.webhooks.create(WebhookRequest(url=URL))
    with pytest.raises(Conflict, match=f"there are {MOST} webhooks already"):
        store.webhooks.create(WebhookRequest(url=URL))


@postgresql_alone
def test_an_event_that_is_committed_late_is_sent_before_those_behind_it(store, outbox):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    reader = outbox.reader()
    with Session(store.database.engine) as slow, slow.begin():
        announce(slow, store.database.now(), mill_events.ALARM_OPENED, "scanner", "slow")
        slow.flush()
        [later] = happen(store, mill_events.ALARM_CLOSED)
        reader.read()
        assert reader.number < later
        assert waiting(outbox, webhook, reader.number) == []
    while reader.number < later:
        reader.read()
    assert [event.subject_id for event in outbox.pending(webhook.id, reader.number).events] == ["slow", "line-2"]


def test_names_and_beginnings_choose_events():
    assert kinds_of(["alarm-*"]) == {mill_events.ALARM_OPENED, mill_events.ALARM_ACKNOWLEDGED, mill_events.ALARM_CLOSED}
    assert kinds_of(["*"]) == set(EventType.published())
    assert kinds_of(["failed", "lost"]) == {event_kinds.FAILED, event_kinds.LOST}


HOST = "alarms.mill.example"


@pytest.mark.parametrize(
    "url",
    [
        *(
            f"ftp://{HOST}/",
            f"https://user:secret@{HOST}/",
            f"https://{HOST}\\@169.254.169.254/",
            f"https://{HOST}/#here",
        ),
        *(f"https://{HOST}:0/", f"https://{HOST}:65536/", f"https://{HOST}/a b", f"https://{HOST}/\r\nHost: other"),
        *("https://älarm.mill.example/", "https:///path", HOST),
    ],
)
def test_what_is_no_plain_url_is_refused(url):
    with pytest.raises(ValidationError, match=r"must be as in|control characters"):
        WebhookRequest(url=url)


def test_a_url_has_the_parts_that_are_sent():
    assert destination_of("https://Alarms.Mill.Example./a?b=1%20c") == Destination(
        scheme="https", host="alarms.mill.example", port=443, target="/a?b=1%20c"
    )
    assert destination_of("https://alarms.mill.example?line=2").target == "/?line=2"
    v6 = destination_of("http://[FD00::1]:8080")
    assert (v6.host, v6.port, v6.target, v6.authority) == ("fd00::1", 8080, "/", "[fd00::1]:8080")


def test_an_entry_of_a_database_that_was_put_back_is_replaced(store, outbox):
    webhook = store.webhooks.create(WebhookRequest(url=URL))
    happen(store, mill_events.ALARM_OPENED)
    pending = outbox.pending(webhook.id, 10**6)
    [event] = pending.events
    outbox.note(pending, event, failed())
    other = event.model_copy(update={"at": event.at + timedelta(days=1)})
    outbox.note(replace(pending, events=[other]), other, DELIVERED)
    [entry] = store.webhooks.deliveries(webhook.id).items
    assert (entry.message_id, entry.attempts) == (message_id(webhook.id, other), 1)
