"""The pages of jobs, of the system and of retention."""

import re
from datetime import UTC, datetime, timedelta

import pytest
from asgi import absent, refusal, text_of
from documented import check_documented
from sqlalchemy import event, insert

from sawmill_contracts import kinds
from sawmill_contracts.plans import PlanRequest
from sawmill_contracts.retention import RetentionKind
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.database.tables import JobRow
from sawmill_service.app import create_app
from sawmill_service.pages.system.system import ACTIONS
from sawmill_service.retention import KINDS
from sawmill_store.mill_tables import CalibrationRow, ReconstructionRow
from sawmill_store.retention.retention_store import RetentionKeeper
from sawmill_vocabulary import Progress

# Thousands of steps of SQLite's machine, which are as many on every computer, and rows that become objects.
MOST_STEPS, MOST_ROWS = 5_000, 500
DECK = 10_000


def asked(store) -> str:
    return store.plans.accept(PlanRequest(scanner_id="example"), given={"phantom_id": "l-shape"}).job_id


def test_a_failure_s_sentence_comes_first_and_what_runs_what_waits_and_what_ended_in_their_order(seeded, store, worker):
    job_id, sentence = asked(store), "the phantom is too large for the detector"
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="phantom-too-large", detail=sentence))
    shown = text_of(seeded.get("/jobs?state=failed").text)
    assert f"Plan of a calibration Failed {sentence} phantom-too-large Requested by the service" in shown
    assert "The queue" not in shown
    history = text_of(seeded.get(f"/jobs/{job_id}/history").text)
    assert absent(history, "attempt 1 started on test", f"attempt 1 failed for good {sentence}") == []
    asked(store)
    store.jobs.heartbeat(worker.claim(), Progress(fraction=0.42, stage="search", seconds_left=75.0))
    asked(store)
    asked(store)
    text = text_of(seeded.get("/jobs").text)
    assert "1 job runs, 2 wait." in text
    now = text[text.index(" Now ") :]
    assert re.search(
        r"Now Plan of a calibration Runs 42 % Searching for the geometry, about 1 minute left Requested by the service",
        now,
    )
    assert re.search(r"The queue Plan of a calibration Next in line .* After 1 other ", now)
    assert re.search(r"Ended, the last requested first .*Drift check Done", now)


def test_jobs_are_shown_by_kind_what_one_made_is_linked_and_one_is_cancelled_twice_without_harm(seeded, store):
    page = seeded.get("/jobs").text
    assert absent(page, 'href="/logs/example"', 'href="/calibrations/example/report"') == []
    assert 'href="/v1/drifts/example"' in page
    asked(store)
    shown = text_of(seeded.get("/jobs?kind=ingest&state=").text)
    assert "Nothing waits." in shown
    assert shown.count("Reading a scan Done") == 2
    assert "Drift check Done" not in shown
    assert seeded.get("/jobs?kind=painting").status_code == 422
    job_id = asked(store)
    assert "What it has done so far is lost." in seeded.get("/jobs").text
    for _ in range(2):
        assert seeded.post(f"/jobs/{job_id}/cancel").headers["Location"] == "/jobs"
        assert store.jobs.get(job_id).state is JobState.CANCELLED
    assert seeded.post("/jobs/nobody/cancel").status_code == 404


def test_the_pages_ask_little_and_are_small_beside_ten_thousand_jobs(client, store):
    fill(store)
    steps, rows = [], []

    def count_steps(connection, *_):
        connection.set_progress_handler(lambda: steps.append(1), 1000)

    def count_row(row, _):
        rows.append(row)

    event.listen(store.database.engine, "checkout", count_steps)
    event.listen(JobRow, "load", count_row)
    for path in ("/jobs", "/jobs/now?kind=calibrate&state=", "/system", "/phantoms"):
        client.get(path)
        steps.clear()
        rows.clear()
        answer = client.get(path)
        assert len(steps) < MOST_STEPS
        assert len(rows) < MOST_ROWS
        assert len(answer.content) < 150_000  # of the 300 KB that a page may have with its styles and scripts
        assert answer.status_code == 200
    event.remove(JobRow, "load", count_row)


def fill(store) -> None:
    now = store.database.now()
    states = (JobState.QUEUED, JobState.SUCCEEDED)
    shared = {"created_at": now, "started_at": now, "kind": kinds.CALIBRATE, "subject_id": "example"}
    rows = [{"id": f"job-{number}", "state": states[number % 2], **shared} for number in range(DECK)]
    with store.database.write() as session:
        session.execute(insert(JobRow), rows)


GIB = 2**30


def test_a_service_in_order_says_so_and_a_worker_is_shown_with_its_job(seeded, store, worker):
    text = text_of(seeded.get("/system").text)
    assert absent(text, "Is it ready? Ready Requests are answered and jobs are done.", "SQLite", "(the newest)") == []
    assert "not used: workers look into the database" in text
    assert "This machine's clock agrees with the service's time." in text.replace("&#39;", "'")
    assert absent(text, "sawmill-calibration", "SAWMILL_MAX_UPLOAD_BYTES 97.7 KiB") == []
    store.plans.accept(PlanRequest(scanner_id="example"), given={"phantom_id": "l-shape"})
    worker.claim()
    assert "test Plan of a calibration" in text_of(seeded.get("/system").text)


def test_a_disk_that_fills_is_seen_before_it_is_full_and_redis_that_is_away_named(client, full_disk, store, settings):
    for free_gib, word, ready in (
        (0.1, "Full", "Disk full"),
        (1, "Nearly full", "Ready"),
        (50, "Room enough", "Ready"),
    ):
        full_disk(int(free_gib * GIB), size_bytes=100 * GIB)
        assert absent(text_of(client.get("/system").text), f"Disk {word} Free", f"Is it ready? {ready}") == []
    client.app = create_app(settings, store, print, broker_url="redis://:secret-word@127.0.0.1:1/0")
    page = client.get("/system").text
    assert "127.0.0.1 does not answer: jobs begin a few seconds later" in page
    assert "secret-word" not in page


def test_an_administrator_alone_sees_keys_audit_and_rules_and_nobody_secrets(client, store):
    key = store.keys.create(KeyRequest(name="scanner <2>", scope=Scope.SUBMIT))
    page = client.get("/system").text
    assert key.secret not in page
    assert "scanner &lt;2&gt; Good submit: may also upload and ask for work" in text_of(page)
    assert "made the key" in text_of(client.get("/audit").text)
    store.keys.revoke(key.id)
    assert "scanner &lt;2&gt; Revoked" in text_of(client.get("/system/keys", follow_redirects=True).text)
    client.bring(Scope.ACTIVATE, name="line 2")
    text = text_of(client.get("/system").text)
    assert "Keys and the audit Your key may not see them. A key of the scope “admin” may." in text
    assert "Make a key" not in text
    assert "made the key" not in text
    assert client.get("/audit").status_code == 403
    client.bring(Scope.ACTIVATE, name="line 2")
    assert (client.get("/v1/retention").status_code, client.get("/v1/retention/preview").status_code) == (200, 403)
    assert (client.put("/v1/retention", json={}).status_code, client.get("/retention").status_code) == (403, 403)
    assert "How long things are kept" not in client.get("/system").text


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


@pytest.fixture
def in_forty_days(store):
    store.database.now = lambda: datetime.now(UTC) + timedelta(days=40)


@pytest.mark.usefixtures("in_forty_days")
def test_rules_are_tried_confirmed_and_carried_out_and_a_wrong_one_is_refused(seeded, store):
    for given in ({"log_scans_days": 0}, {"log_scans_bytes": 10**9}, {"log_scans_days": 36_501}):
        assert seeded.put("/v1/retention", json=given).status_code == 422
    assert seeded.get("/v1/retention/preview?log_scans_days=soon").status_code == 422
    refused = seeded.put("/v1/retention", json={"drifts_days": 30})
    check_documented(refused)
    assert refusal(refused) == (409, "retention-unconfirmed")
    shown = seeded.get("/v1/retention/preview?drifts_days=30&calibrations_days=30").json()
    by_kind = {kind["kind"]: kind for kind in shown["kinds"]}
    assert (by_kind["drifts"]["number"], by_kind["calibrations"]["number"]) == (1, 0)
    assert by_kind["calibrations"]["stays"] == 1
    put = seeded.put("/v1/retention", json={**shown["rules"], "remove_at_most": shown["number"]})
    check_documented(put)
    assert (put.json()["rules"]["drifts_days"], put.json()["changed_by"]) == (30, "somebody at this machine")
    assert seeded.get("/v1/retention/preview").json()["rules"] == shown["rules"], "those in force"
    assert RetentionKeeper(store.database, store.files).remove_some().kind == "drifts"
    assert seeded.get("/v1/drifts/example").status_code == 404
    [removed] = [each for each in seeded.get("/v1/retention").json()["removed"] if each["number"]]
    assert (removed["kind"], removed["number"]) == ("drifts", 1)
    assert 'sawmill_retention_removed_total{kind="drifts"} 1.0' in seeded.get("/metrics").text


@pytest.mark.usefixtures("in_forty_days")
def test_the_page_shows_first_and_changes_what_was_confirmed_alone(seeded, store):
    seeded.headers["Accept-Language"] = "fi"
    wrong = seeded.post("/retention", data={"log_scans_days": "1.5"})
    assert wrong.status_code == 422
    assert "täytyy olla kokonainen määrä päiviä" in text_of(wrong.text)
    page = seeded.post("/retention", data={"drifts_days": "30", "reconstructions_days": "1 000"})
    assert "Siirtymän tarkistukset 1 :" in text_of(page.text)
    assert store.retention.get().changed_at is None
    assert "Poistetaanko 1 kohde?" in text_of(page.text)
    number = re.search(r'name="remove_at_most" value="([^"]+)"', page.text)[1]
    for fewer in ("0", "all"):
        refused = seeded.post("/retention/confirmed", data={"drifts_days": "30", "remove_at_most": fewer})
        assert refused.status_code == 409
        assert "Säännöt poistaisivat nyt enemmän kuin vahvistettiin" in text_of(refused.text)
        assert f'name="remove_at_most" value="{number}"' in refused.text
    typed = {"drifts_days": "30", "reconstructions_days": "1 000", "remove_at_most": number}
    assert seeded.post("/retention/confirmed", data=typed).status_code == 303
    assert store.retention.get().rules.reconstructions_days == 1000
    assert 'value="1000"' in seeded.get("/retention").text


def test_every_kind_and_every_action_of_the_audit_has_words():
    assert set(KINDS) == set(RetentionKind)
    decisions = {kind for kind in EventType.all() if kind.is_decision}
    assert not (decisions - ACTIONS.keys()), "add them to ACTIONS in service/sawmill_service/pages/system/system.py"
    assert not ACTIONS.keys() - decisions, "no audit keeps these: remove them from ACTIONS"


AT = datetime(2026, 1, 15, 21, 30, tzinfo=UTC)


def test_names_pages_and_the_report_write_times_in_the_mill_s_zone(seeded, store):
    with store.database.write() as session:
        for table in (CalibrationRow, ReconstructionRow):
            session.get(table, "example").created_at = AT
    for name in ("example", "example-spare"):
        store.schedules.delete(name)
    assert "data-sets-zone" in seeded.get("/").text
    seeded.post("/operator/time-zone", data={"time_zone": "Asia/Tokyo", "first": "yes"})
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Berlin", "first": "yes"})
    assert store.mill_zone.get() == "Asia/Tokyo"
    log = seeded.get("/logs/example").text
    assert absent(log, 'data-zone="Asia/Tokyo"', "log 1, 06:30</h1>", ">16 Jan 2026, 06:30</time>") == []
    assert "16.1.2026 6.30 (Asia/Tokyo)" in seeded.get("/calibrations/example/report?language=fi").text
    assert "data-sets-zone" not in seeded.get("/").text


def test_only_an_administrator_sets_another_zone_and_only_one_that_exists(seeded, store):
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Helsinki", "first": "yes"})
    assert seeded.post("/operator/time-zone", data={"time_zone": "Pori"}).json()["code"] == "invalid-zone"
    seeded.post("/operator/time-zone", data={"time_zone": "Europe/Stockholm"})
    assert "Names, reports and pages write times in Europe/Stockholm." in seeded.get("/system").text
    seeded.bring(Scope.ACTIVATE)
    assert seeded.post("/operator/time-zone", data={"time_zone": "Asia/Tokyo"}).status_code == 403
    assert store.mill_zone.get() == "Europe/Stockholm"
