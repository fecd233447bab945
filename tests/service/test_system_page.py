"""The page of the system, as HTML."""

import pytest
from page_text import text_of

from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_service.app import create_app
from sawmill_service.pages.system.system import ACTIONS

GIB = 2**30


def test_a_service_in_order_says_so_and_a_worker_is_shown_with_its_job(seeded, store, worker):
    text = text_of(seeded.get("/system").text)
    assert "Is it ready? Ready Requests are answered and jobs are done." in text
    assert "SQLite" in text
    assert "(the newest)" in text
    assert "not used: workers look into the database" in text
    assert "This machine's clock agrees with the service's time." in text.replace("&#39;", "'")
    assert "sawmill-calibration" in text
    assert "SAWMILL_MAX_UPLOAD_BYTES 97.7 KiB" in text
    store.plans.accept(PlanAsk(scanner_id="example"), given={"phantom_id": "l-shape"})
    worker.claim()
    assert "test Plan of a calibration" in text_of(seeded.get("/system").text)


@pytest.mark.parametrize(
    ("free_gib", "word", "ready"),
    [(0.1, "Full", "Disk full"), (1, "Nearly full", "Ready"), (50, "Room enough", "Ready")],
)
def test_a_disk_that_fills_is_seen_before_it_is_full(client, full_disk, free_gib, word, ready):
    full_disk(int(free_gib * GIB), size_bytes=100 * GIB)
    text = text_of(client.get("/system").text)
    assert f"Disk {word} Free" in text
    assert f"Is it ready? {ready}" in text


def test_redis_that_is_away_is_named_without_its_password(client, store, settings):
    client.app = create_app(settings, store, print, broker_url="redis://:secret-word@127.0.0.1:1/0")
    page = client.get("/system").text
    assert "127.0.0.1 does not answer: jobs begin a few seconds later" in page
    assert "secret-word" not in page


def test_an_administrator_sees_keys_and_the_audit_without_secrets(client, store):
    key = store.keys.create(KeyAsk(name="scanner <2>", scope=Scope.SUBMIT))
    page = client.get("/system").text
    assert key.secret not in page
    text = text_of(page)
    assert "scanner &lt;2&gt; Good submit: may also upload and ask for work" in text
    assert "made the key" in text_of(client.get("/audit").text)
    store.keys.revoke(key.id)
    assert "scanner &lt;2&gt; Revoked" in text_of(client.get("/system/keys", follow_redirects=True).text)


def test_nobody_else_does_and_is_told_so(client):
    client.bring(Scope.ACTIVATE, name="line 2")
    text = text_of(client.get("/system").text)
    assert "Keys and the audit Your key may not see them. A key of the scope “admin” may." in text
    assert "Make a key" not in text
    assert "made the key" not in text
    assert client.get("/audit").status_code == 403


def test_the_audit_answers_who_changed_a_tolerance_and_when(seeded):
    seeded.bring(Scope.ADMIN, name="anna")
    spec = seeded.get("/v1/scanners/example").json()
    looser = {name: spec[name] for name in ("name", "constants")} | {"tolerances": {"predicted_ray_error_mm": 0.25}}
    seeded.put("/v1/scanners/example", json=looser)
    seeded.delete("/v1/schedules/example")
    table = seeded.get("/audit?who=anna&action=scanner-changed&zone=Europe/Helsinki").text.partition("<tbody>")[2]
    assert "changed the scanner example tolerances.predicted_ray_error_mm 0.1 → 0.25" in text_of(table)
    assert "deleted the schedule" not in text_of(table)
    assert "There is no entry here." in seeded.get("/audit?last=2020-05-31").text
    assert "There is no entry here." in seeded.get("/audit?who=nobody").text
    assert {seeded.get(f"/audit?{query}").status_code for query in ("action=queue", "first=soon")} == {422}


def test_every_action_of_the_audit_has_words():
    decisions = {kind for kind in EventKind.all() if kind.is_decision}
    without = decisions - ACTIONS.keys()
    assert not without, "add them to ACTIONS in service/sawmill_service/pages/system/system.py"
    assert not ACTIONS.keys() - decisions, "no audit keeps these: remove them from ACTIONS"
