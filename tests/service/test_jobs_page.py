"""The page of jobs, as HTML."""

import re

from page_text import text_of
from sqlalchemy import event, insert

from sawmill_contracts import kinds
from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_platform.database.tables import JobRow
from sawmill_vocabulary import Progress, Theta

NOMINAL = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=740.0, source_shift_mm=200.0, detector_shift_mm=30.0, detector_tilt=0.2
)
# Thousands of steps of SQLite's machine, which are as many on every computer, and rows that become objects.
MOST_STEPS, MOST_ROWS = 5_000, 500
DECK = 10_000


def asked(store) -> str:
    """A plan's job."""
    plan = store.plans.accept(PlanAsk(scanner_id="example", theta=NOMINAL), given={"phantom_id": "l-shape"})
    return plan.job_id


def test_what_runs_what_waits_and_what_ended_stand_in_their_order(seeded, store, worker):
    asked(store)
    claim = worker.claim()
    store.jobs.heartbeat(claim, Progress(fraction=0.42, stage="search", seconds_left=75.0))
    asked(store)
    asked(store)
    text = text_of(seeded.get("/jobs").text)
    assert "1 job runs, 2 wait." in text
    now = text[text.index(" Now ") :]
    assert re.search(r"Now Plan of a calibration Runs 42 % search , about 1 minute left Asked for by the service", now)
    assert re.search(r"The queue Plan of a calibration Next in line .* After 1 other ", now)
    assert re.search(r"Ended, those asked for last first .*Drift check Done", now)


def test_a_failure_s_sentence_comes_first_and_its_attempts_are_listed(seeded, store, worker):
    job_id = asked(store)
    sentence = "the phantom is too large for the detector"
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="phantom-too-large", detail=sentence))
    shown = text_of(seeded.get("/jobs?state=failed").text)
    assert f"Plan of a calibration Failed {sentence} phantom-too-large Asked for by the service" in shown
    assert "The queue" not in shown
    history = text_of(seeded.get(f"/jobs/{job_id}/history").text)
    assert "attempt 1 started on test" in history
    assert f"attempt 1 failed for good: {sentence}" in history


def test_what_a_job_made_is_linked(seeded):
    page = seeded.get("/jobs").text
    assert 'href="/logs/example"' in page
    assert 'href="/calibrations/example/report"' in page
    assert 'href="/v1/drifts/example"' in page


def test_jobs_are_shown_by_kind(seeded, store):
    asked(store)
    shown = text_of(seeded.get("/jobs?kind=ingest&state=").text)
    assert "Nothing waits." in shown
    assert shown.count("Reading a scan Done") == 2
    assert "Drift check Done" not in shown
    assert seeded.get("/jobs?kind=painting").status_code == 422


def test_a_job_is_cancelled_from_the_page_and_twice_does_no_harm(seeded, store):
    job_id = asked(store)
    page = seeded.get("/jobs").text
    assert "What it has done so far is lost." in page
    for _ in range(2):
        assert seeded.post(f"/jobs/{job_id}/cancel").headers["Location"] == "/jobs"
        assert store.jobs.get(job_id).state is JobState.CANCELLED
    assert seeded.post("/jobs/nobody/cancel").status_code == 404


def test_whoever_may_only_look_cancels_nothing(seeded, store):
    job_id = asked(store)
    key = store.keys.create(KeyAsk(name="visitor", scope=Scope.READ))
    seeded.headers["Authorization"] = f"Bearer {key.secret}"
    assert "Yes, cancel it" not in seeded.get("/jobs").text
    assert seeded.post(f"/jobs/{job_id}/cancel").status_code == 403


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
    """Half of them wait, half have succeeded."""
    now = store.database.now()
    states = (JobState.QUEUED, JobState.SUCCEEDED)
    shared = {"created_at": now, "started_at": now, "kind": kinds.CALIBRATE, "subject_id": "example"}
    rows = [{"id": f"job-{number}", "state": states[number % 2], **shared} for number in range(DECK)]
    with store.database.write() as session:
        session.execute(insert(JobRow), rows)
