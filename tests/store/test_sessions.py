"""Sessions of browsers, on both databases."""

import pytest
from sqlalchemy import func, select, text

from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.database.tables import SessionRow
from sawmill_platform.keys.key_store import hash_of
from sawmill_platform.keys.sessions import LASTS, RENEWAL_STEP

pytestmark = pytest.mark.clocked

OPENER = hash_of("the token")


def count(store):
    with store.database.read() as session:
        return session.scalar(select(func.count()).select_from(SessionRow))


def test_a_session_is_found_by_its_secret_which_is_not_stored(store):
    secret = store.sessions.open(OPENER, lasting=False)
    assert len(secret) == 43  # 256 bits, in base64
    assert store.sessions.find(secret).opened_by_hash == OPENER
    assert store.sessions.find(secret + "x") is store.sessions.find(OPENER) is None
    with store.database.read() as session:
        assert secret not in str(session.execute(text("SELECT * FROM sessions")).all())


def test_a_person_s_session_runs_out_unless_it_is_used(store, clock):
    secret, idle = (store.sessions.open(OPENER, lasting=False) for _ in range(2))
    for _ in range(24):
        clock.advance(hours=1)
        store.sessions.renew(store.sessions.find(secret))
    assert store.sessions.find(secret) is not None
    assert store.sessions.find(idle) is None
    clock.advance(seconds=LASTS.total_seconds())
    assert store.sessions.find(secret) is None


def test_a_session_in_use_is_written_once_an_hour(store, clock):
    secret = store.sessions.open(OPENER, lasting=False)
    first = store.sessions.find(secret).expires_at
    clock.advance(seconds=RENEWAL_STEP.total_seconds() - 1)
    store.sessions.renew(store.sessions.find(secret))
    assert store.sessions.find(secret).expires_at == first
    clock.advance(seconds=1)
    store.sessions.renew(store.sessions.find(secret))
    assert store.sessions.find(secret).expires_at == first + RENEWAL_STEP


@pytest.mark.dialect
def test_a_link_is_used_once_within_ten_minutes(store, clock):
    key = store.keys.create(KeyAsk(name="tablet", scope=Scope.READ, display=True))
    first, second = store.sessions.invite(key.id), store.sessions.invite(key.id)
    clock.advance(minutes=9)
    assert [store.sessions.use_link(first), store.sessions.use_link(first)] == [hash_of(key.secret), None]
    clock.advance(minutes=1)
    assert store.sessions.use_link(second) is None
    assert count(store) == 0


@pytest.mark.dialect
def test_a_login_removes_the_sessions_that_have_ended(store, clock):
    ask = KeyAsk(name="tablet", scope=Scope.READ, display=True)
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
