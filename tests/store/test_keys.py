"""Keys, the sessions that they open, and the audit, on both databases."""

from datetime import timedelta

import pytest
from sqlalchemy import func, select, text
from sqlalchemy.exc import DBAPIError

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.database.tables import SessionRow
from sawmill_platform.errors import Conflict, Invalid, NotFound
from sawmill_platform.keys.key_store import PREFIX, RENEWAL_STEP, SESSION_LASTS, USE_STEP, hash_of
from sawmill_platform.ledger.events import Actor, acting_as

pytestmark = pytest.mark.clocked

ASK = KeyRequest(name="scanner software", scope=Scope.SUBMIT)


def opens(store, key):
    return store.keys.good(hash_of(key.secret)) is not None


def test_a_secret_is_shown_once_and_stored_as_a_hash(store):
    key = store.keys.create(ASK)
    assert key.secret.startswith(PREFIX)
    assert len(key.secret) == len(PREFIX) + 43  # 256 bits, in base64
    assert key.secret not in repr(key)
    assert opens(store, key)
    assert not hasattr(store.keys.all()[0], "secret")
    with store.database.read() as session:
        assert key.secret not in str(session.execute(text("SELECT * FROM keys")).all())
    assert [entry for entry in store.audit.all() if key.secret in str(entry)] == []


def test_a_key_that_expired_or_was_revoked_opens_nothing(store, clock):
    soon = store.keys.create(ASK.model_copy(update={"expires_at": clock() + timedelta(hours=1)}))
    revoked, kept = store.keys.create(ASK), store.keys.create(ASK)
    store.keys.revoke(revoked.id)
    assert [opens(store, key) for key in (soon, revoked, kept)] == [True, False, True]
    clock.advance(hours=1)
    assert [opens(store, key) for key in (soon, revoked, kept)] == [False, False, True]
    store.keys.revoke(kept.id)
    assert not store.keys.any_good()
    assert store.keys.revoke(kept.id).revoked_at is not None  # again changes nothing
    with pytest.raises(Conflict, match="revoked or expired"):
        store.keys.rotate(soon.id)
    with pytest.raises(NotFound):
        store.keys.revoke("nobody")
    with pytest.raises(Invalid, match="must lie ahead"):
        store.keys.create(ASK.model_copy(update={"expires_at": clock()}))


def test_a_rotated_key_opens_by_its_old_secret_for_the_grace_alone(store, clock):
    old = store.keys.create(ASK)
    new = store.keys.rotate(old.id, grace_s=60)
    assert (new.id, opens(store, old), opens(store, new)) == (old.id, True, True)
    clock.advance(seconds=60)
    assert (opens(store, old), opens(store, new)) == (False, True)
    newest = store.keys.rotate(old.id)
    assert (opens(store, new), opens(store, newest)) == (False, True)


@pytest.mark.dialect
def test_the_last_use_is_kept_to_a_minute(store, clock):
    key = store.keys.create(ASK)
    first = clock()
    store.keys.used(key)
    for _ in range(2):
        clock.advance(seconds=USE_STEP.total_seconds() / 2)
        store.keys.used(store.keys.all()[0])
    assert store.keys.all()[0].last_used_at == first + USE_STEP


@pytest.mark.dialect
def test_the_audit_names_who_and_only_grows(store):
    with acting_as(Actor("anna", key_id="k1", address="192.0.2.7", request_id="r1")):
        key = store.keys.create(ASK)
    store.keys.revoke(key.id)
    made, revoked = store.audit.all()
    assert (made.who, made.key_id, made.address, made.request_id) == ("anna", "k1", "192.0.2.7", "r1")
    assert (made.action, made.subject_id) == (event_kinds.KEY_CREATED, key.id)
    assert (revoked.who, revoked.key_id) == ("the service", None)
    newest = store.audit.page(limit=1)
    assert (newest.items, store.audit.page(after=newest.next).items) == ([revoked], [made])
    with pytest.raises(Invalid, match="must be the next of an earlier page, not '-1'"):
        store.audit.page(after="-1")
    changes = ["UPDATE events SET who = 'nobody'", "DELETE FROM events"]
    if store.database.engine.dialect.name == "sqlite":
        names = "number, at, class, type, who, subject_id"
        changes.append(f"INSERT OR REPLACE INTO events ({names}) SELECT {names} FROM events")  # noqa: S608 - constants
    for change in changes:
        refused = pytest.raises(DBAPIError, match="decisions of the ledger stay as they are")
        with refused, store.database.engine.begin() as connection:
            connection.execute(text(change))
    assert list(store.audit.all()) == [made, revoked]


OPENER = hash_of("the token")


@pytest.mark.dialect
def test_a_link_is_used_once_within_ten_minutes(store, clock):
    key = store.keys.create(KeyRequest(name="tablet", scope=Scope.READ, display=True))
    first, second = store.sessions.invite(key.id), store.sessions.invite(key.id)
    clock.advance(minutes=9)
    assert [store.sessions.use_link(first), store.sessions.use_link(first)] == [hash_of(key.secret), None]
    clock.advance(minutes=1)
    assert store.sessions.use_link(second) is None
    assert count(store) == 0


@pytest.mark.dialect
def test_a_login_removes_the_sessions_that_have_ended(store, clock):
    ask = KeyRequest(name="tablet", scope=Scope.READ, display=True)
    kept, revoked, rotated = (store.keys.create(ask) for _ in range(3))
    displays = [store.sessions.open(hash_of(key.secret), lasting=True) for key in (kept, revoked, rotated)]
    store.sessions.open(OPENER, lasting=False)
    store.keys.revoke(revoked.id)
    store.keys.rotate(rotated.id, grace_s=86400)
    clock.advance(hours=12)
    store.sessions.open(OPENER, lasting=False)
    assert [store.sessions.find(secret) is not None for secret in displays] == [True, False, True]
    assert count(store) == 3
    clock.advance(hours=12)
    store.sessions.open(OPENER, lasting=False)
    assert [store.sessions.find(secret) is not None for secret in displays] == [True, False, False]


def count(store):
    with store.database.read() as session:
        return session.scalar(select(func.count()).select_from(SessionRow))


def test_a_person_s_session_is_found_by_its_secret_alone_until_it_was_not_used_for_long(store, clock):
    secret, idle = (store.sessions.open(OPENER, lasting=False) for _ in range(2))
    assert store.sessions.find(secret).opened_by_hash == OPENER
    assert store.sessions.find(secret + "x") is store.sessions.find(OPENER) is None
    with store.database.read() as session:
        assert secret not in str(session.execute(text("SELECT * FROM sessions")).all())
    first = store.sessions.find(secret).expires_at
    for seconds, moved in ((RENEWAL_STEP.total_seconds() - 1, first), (1, first + RENEWAL_STEP)):
        clock.advance(seconds=seconds)
        store.sessions.renew(store.sessions.find(secret))
        assert store.sessions.find(secret).expires_at == moved, "written once an hour"
    for _ in range(23):
        clock.advance(hours=1)
        store.sessions.renew(store.sessions.find(secret))
    assert store.sessions.find(secret) is not None
    assert store.sessions.find(idle) is None
    clock.advance(seconds=SESSION_LASTS.total_seconds())
    assert store.sessions.find(secret) is None
