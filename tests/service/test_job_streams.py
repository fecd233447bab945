"""Streams of a job that are cut and begin anew: no state is missed, and the end comes once."""

import threading
from collections.abc import Callable

import pytest
from asgi import blocks
from machine_faults import database_away

from sawmill_platform.contracts.jobs import Job, JobState
from sawmill_platform.jobs.job_store import Jobs
from sawmill_service.app import create_app
from sawmill_store.subjects.mill_subjects import MILL_SUBJECTS
from sawmill_vocabulary import Progress


@pytest.fixture
def job_id(seeded) -> str:
    return seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]


@pytest.fixture
def listen(seeded, job_id) -> Callable[..., str]:
    """The text of a stream."""

    def text(last_id: str | None = None) -> str:
        headers = {} if last_id is None else {"Last-Event-ID": last_id}
        answer = seeded.get(f"/v1/jobs/{job_id}/events", headers=headers, timeout=60)
        assert answer.status_code == (200 if answer.text else 204)
        return answer.text

    return text


@pytest.fixture
def stop_and_start(seeded, store, settings) -> Callable[[], None]:
    """The service ends, and another one begins on the same data."""

    def act() -> None:
        seeded.app.state.stopping.begin()
        seeded.app = create_app(settings, store, lambda _: None)

    return act


def test_a_stream_begins_with_the_time_to_come_back_and_its_ids_are_numbers_of_events(store, worker, job_id, listen):
    numbers = [event.number for event in store.events.following(0) if event.job_id == job_id]
    threading.Timer(0.3, worker.finish_calibration).start()
    heard = blocks(listen())
    events = [event for event in store.events.following(0) if event.job_id == job_id]
    assert [event.what for event in events[:3]] == ["queued", "started", "succeeded"]
    queued, started, ended = [event.number for event in events[:3]]
    assert (numbers, heard[0]["event"], heard[0]["id"], heard[0]["retry"]) == ([queued], "job", str(queued), "1000")
    assert {block["id"] for block in heard[1:-1]} <= {str(queued), str(started)}
    assert (heard[-1]["event"], heard[-1]["id"], heard[-2]["id"]) == ("end", str(ended), str(started))


def test_wherever_a_stream_is_cut_the_final_state_comes_and_the_end_once(worker, listen, stop_and_start):
    threading.Timer(0.3, worker.finish_calibration).start()
    whole = listen()
    stop_and_start()
    again: dict[str | None, str] = {}
    for cut in range(len(whole) + 1):
        heard = blocks(whole[:cut])
        last_id = heard[-1]["id"] if heard else None
        if last_id not in again:
            again[last_id] = listen(last_id)
        heard += blocks(again[last_id])
        assert [block["event"] for block in heard].count("end") == 1, cut
        assert heard[-1]["event"] == "end", cut
        assert [block["data"] for block in heard if block["event"] == "job"][-1]["state"] == "succeeded", cut
    assert again[blocks(whole)[-1]["id"]] == ""


def test_a_running_job_is_sent_as_it_is_whatever_the_client_has_seen(seeded, store, worker, listen, stop_and_start):
    """Progress has no event of its own: a client may hold the newest number and an older state."""
    claim = worker.claim()
    for fraction in (0.25, 0.5):
        store.jobs.heartbeat(claim, Progress(fraction=fraction, stage="search"))
        threading.Timer(0.2, seeded.app.state.stopping.begin).start()
        first, *_, closing = blocks(listen(str(store.events.numbers_of_job(claim.job_id).latest)))
        assert (first["event"], first["data"]["progress"]["fraction"]) == ("job", fraction)
        assert (closing["event"], closing["id"], closing["retry"]) == ("closing", first["id"], "1000")
        stop_and_start()


def test_a_job_that_ends_between_two_looks_has_the_number_of_its_end(store, worker, job_id, listen):
    """Its numbers are read before its row."""

    class EndingFirst(Jobs):
        def get(self, job_id: str) -> Job:
            if super().get(job_id).state is JobState.QUEUED:
                worker.finish_calibration()
            return super().get(job_id)

    store.jobs = EndingFirst(store.database, store.files, MILL_SUBJECTS)
    *_, job, end = blocks(listen())
    latest, ended = store.events.numbers_of_job(job_id)
    assert (job["id"], end["id"]) == (str(latest), str(ended))


def test_a_job_of_the_first_versions_has_an_end_without_an_event(seeded):
    for headers in ({}, {"Last-Event-ID": "0"}):
        job, end = blocks(seeded.get("/v1/jobs/example/events", headers=headers).text)
        assert (job["event"], end["event"], "id" in end) == ("job", "end", False)


def test_an_id_that_was_never_given_is_one_of_before_and_no_number_is_refused(seeded, store, worker, job_id, listen):
    worker.finish_calibration()
    newest = store.events.newest_number()
    for other in ("0", str(newest + 1)):
        assert [block["event"] for block in blocks(listen(other))] == ["job", "end"]
    for wrong in ("-1", "x"):
        answer = seeded.get(f"/v1/jobs/{job_id}/events", headers={"Last-Event-ID": wrong})
        assert (answer.status_code, "Last-Event-ID" in answer.json()["detail"]) == (422, True)


def test_an_outage_changes_no_id(seeded, store, worker, job_id):
    def go_away_and_come_back() -> None:
        with database_away(store.database) as met:
            assert met.wait(60)
        worker.finish_calibration()

    queued, _ = store.events.numbers_of_job(job_id)
    going = threading.Thread(target=go_away_and_come_back)
    heard = blocks(seeded.follow(f"/v1/jobs/{job_id}/events", lambda _: going.ident or going.start()))
    going.join()
    latest, ended = store.events.numbers_of_job(job_id)
    # In between the stream may have seen the job run.
    assert [heard[0]["event"], *(block["event"] for block in heard[-2:])] == ["job", "job", "end"]
    assert [heard[0]["id"], *(block["id"] for block in heard[-2:])] == [str(queued), str(latest), str(ended)]
    assert {block["id"] for block in heard} <= {str(number) for number in range(queued, ended + 1)}
