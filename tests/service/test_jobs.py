"""Jobs over HTTP: their places, waits for their ends, and streams that are cut and begin anew."""

import asyncio
import threading
from collections.abc import Sequence

import pytest
from asgi import blocks, refusal, scope_of
from machine_faults import database_away

from sawmill_platform.contracts.events import Event
from sawmill_platform.contracts.jobs import Failure, FailureKind, Job, JobState, Priority
from sawmill_platform.jobs.job_store import Jobs
from sawmill_service.app import create_app
from sawmill_service.event_feed import EventFeed
from sawmill_service.http.responses.waiting import JobEnds
from sawmill_store.subjects.mill_subjects import MILL_SUBJECTS
from sawmill_vocabulary import Progress


@pytest.fixture
def job_id(seeded):
    return seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]


def test_jobs_have_their_place_and_a_queued_one_is_cancelled_at_once(seeded, job_id):
    assert [job["id"] for job in seeded.get("/v1/jobs?kind=calibrate&state=queued").json()["items"]] == [job_id]
    assert {job["kind"] for job in seeded.get("/v1/jobs?kind=ingest").json()["items"]} == {"ingest"}
    second = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]
    assert [seeded.get(f"/v1/jobs/{each}").json()["queue_position"] for each in (job_id, second)] == [0, 1]
    answer = seeded.post(f"/v1/jobs/{job_id}/cancel")
    assert answer.json()["state"] == "cancelled"
    assert seeded.get(answer.headers["Location"]).json()["state"] == "cancelled"
    assert seeded.post("/v1/jobs/example/cancel").json()["state"] == "succeeded"
    assert seeded.post("/v1/jobs/nothing/cancel").status_code == 404


def test_the_stream_carries_each_change_and_then_ends(seeded, store, worker, job_id):
    claims = []

    def work(block: str) -> None:
        """Change the job once the stream has carried the change before."""
        [job] = [each["data"] for each in blocks(f"{block}\n\n")]
        if job == "failed":
            return
        known = (job["state"], (job["progress"] or {}).get("fraction"))
        if known == ("queued", None):
            claims.append(worker.claim())
        if known in {("queued", None), ("running", 0.25)}:
            fraction = 0.25 if known[1] is None else 0.5
            store.jobs.heartbeat(claims[0], Progress(fraction=fraction, stage="search", generation=3))
        elif known == ("running", 0.5):
            failure = Failure(kind=FailureKind.INPUT, code="phantom-not-seen", detail="no phantom here")
            store.jobs.fail(claims[0], failure)

    seen = blocks(seeded.follow(f"/v1/jobs/{job_id}/events", work))
    assert ({each["event"] for each in seen[:-1]}, seen[-1]["event"], seen[-1]["data"]) == ({"job"}, "end", "failed")
    jobs = [each["data"] for each in seen[:-1]]
    states = [(job["state"], (job["progress"] or {}).get("fraction")) for job in jobs]
    assert [state for state in states if state[0] == "running"][-2:] == [("running", 0.25), ("running", 0.5)]
    assert jobs[-1]["failure"]["code"] == "phantom-not-seen"


def test_a_running_job_is_asked_to_stop(seeded, store, worker, job_id):
    claim = worker.claim()
    assert seeded.post(f"/v1/jobs/{job_id}/cancel").json()["cancel_requested"]
    assert store.jobs.heartbeat(claim)


def test_what_can_wait_says_so_and_comes_after_those_who_wait(seeded, store):
    ask = {"scan_id": "example"}
    night, day = (seeded.post(f"/v1/calibrations{query}", json=ask).json() for query in ("?priority=batch", ""))
    jobs = [seeded.get(f"/v1/jobs/{asked['job_id']}").json() for asked in (night, day)]
    assert [(job["priority"], job["queue_position"]) for job in jobs] == [("batch", 1), ("interactive", 0)]
    # A result that somebody waits for brings forward what it needs.
    needs_it = {"scan_id": "example", "calibration_id": night["id"]}
    assert seeded.post("/v1/reconstructions?priority=batch", json=needs_it).status_code == 202
    assert store.jobs.get(night["job_id"]).priority is Priority.BATCH
    assert seeded.post("/v1/reconstructions", json=needs_it).status_code == 202
    assert store.jobs.get(night["job_id"]).priority is Priority.INTERACTIVE
    refused = seeded.post("/v1/calibrations?priority=now", json=ask)
    assert (refused.status_code, "'interactive', 'batch' or 'background'" in refused.text) == (422, True)
    query = {"scanner_id": "example", "data": "counts", "priority": "batch"}
    scan = seeded.post("/v1/scans", params=query, content=b"scan").json()
    picture = seeded.post("/v1/phantoms/pictures?name=x&width_mm=9&priority=background", content=b"png").json()
    jobs = [store.jobs.get(accepted["job_id"]) for accepted in (scan, picture)]
    assert [job.priority for job in jobs] == [Priority.BATCH, Priority.BACKGROUND]


SCAN, PICTURE = "/v1/scans?scanner_id=example&data=counts", "/v1/phantoms/pictures?name=x&width_mm=9"


def test_a_wait_ends_with_the_job(seeded, worker):
    for asked, of_job, finish, state in (
        ("/v1/calibrations", True, "finish_calibration", "succeeded"),
        ("/v1/calibrations", False, "finish_calibration", "succeeded"),
        (SCAN, False, "finish_scan", "ready"),
        (PICTURE, False, "finish_tracing", "ready"),
    ):
        sent = {"json": {"scan_id": "example"}} if asked == "/v1/calibrations" else {"content": b"a file"}
        accepted = seeded.post(asked, **sent)
        path = f"/v1/jobs/{accepted.json()['job_id']}" if of_job else accepted.headers["Location"]
        threading.Timer(0.3, getattr(worker, finish)).start()
        answer = seeded.get(f"{path}?wait=50", timeout=60)
        assert answer.json()["state"] == state
        assert "Retry-After" not in answer.headers


def test_a_wait_is_over_in_time_or_when_the_client_goes_or_the_service_stops(seeded, job_id):
    for path in ("jobs/example", "scans/example", "phantoms/l-shape", "plans/example", "drifts/example"):
        answer = seeded.get(f"/v1/{path}?wait=50", timeout=60)
        assert answer.status_code == 200
        assert "Retry-After" not in answer.headers
    for query in ("", "?wait=0", "?wait=0.2"):
        answer = seeded.get(f"/v1/jobs/{job_id}{query}")
        assert (answer.json()["state"], answer.headers["Retry-After"]) == ("queued", "1")
    for wrong in ("61", "-1", "nan", "soon", ""):
        assert seeded.get(f"/v1/jobs/{job_id}?wait={wrong}").status_code == 422
    # Else clients that gave up would hold the places of those who ask.
    messages, sent = [{"type": "http.disconnect"}, {"type": "http.request", "body": b""}], []

    async def receive():
        return messages.pop()

    async def send(message):
        sent.append(message)

    async def ask():
        async with asyncio.timeout(60):
            await seeded.app(scope_of(f"/v1/jobs/{job_id}?wait=50"), receive, send)

    asyncio.run(ask())
    assert messages == []
    assert sent
    threading.Timer(0.3, seeded.app.state.stopping.begin).start()
    answer = seeded.get(f"/v1/jobs/{job_id}?wait=50", timeout=60)
    assert (answer.status_code, answer.json()["state"]) == (200, "queued")


def test_a_wait_outlives_a_database_that_does_not_answer_and_is_over_in_time_though_nobody_reads(seeded, store, job_id):
    class Hanging(EventFeed):
        async def start(self, _: int | None) -> int:
            return await asyncio.Future()

    class Failing(EventFeed):
        async def start(self, _: int | None) -> int:
            raise RuntimeError("a defect")

    state = seeded.app.state
    state.job_ends = JobEnds(Hanging(store.events, 0.01), state.stopping, 0.01)
    assert seeded.get(f"/v1/jobs/{job_id}?wait=0.2").json()["state"] == "queued"
    state.job_ends = JobEnds(Failing(store.events, 0.01), state.stopping, 0.01)
    assert refusal(seeded.get(f"/v1/jobs/{job_id}?wait=50")) == (500, "internal")
    waits = threading.Event()

    class Followed(EventFeed):
        async def after(self, number: int, scanner_id: str | None = None) -> tuple[int, Sequence[Event]]:
            waits.set()
            return await super().after(number, scanner_id)

    def go_away_and_come_back() -> None:
        assert waits.wait(60)
        with database_away(store.database) as met:
            assert met.wait(60)
        store.jobs.request_cancel(job_id)

    state = seeded.app.state
    state.job_ends = JobEnds(Followed(store.events, 0.01), state.stopping, 0.01)
    going = threading.Thread(target=go_away_and_come_back)
    going.start()
    assert seeded.get(f"/v1/jobs/{job_id}?wait=50", timeout=60).json()["state"] == "cancelled"
    going.join()


def listen(seeded, job_id, last_id: str | None = None) -> str:
    headers = {} if last_id is None else {"Last-Event-ID": last_id}
    answer = seeded.get(f"/v1/jobs/{job_id}/events", headers=headers, timeout=60)
    assert answer.status_code == (200 if answer.text else 204)
    return answer.text


def stop_and_start(seeded, store, settings) -> None:
    """The service ends, and another one begins on the same data."""
    seeded.app.state.stopping.begin()
    seeded.app = create_app(settings, store, lambda _: None)


def test_a_stream_begins_with_the_time_to_come_back_and_its_ids_are_numbers_of_events(seeded, store, worker, job_id):
    numbers = [event.number for event in store.events.following(0) if event.job_id == job_id]
    threading.Timer(0.3, worker.finish_calibration).start()
    heard = blocks(listen(seeded, job_id))
    events = [event for event in store.events.following(0) if event.job_id == job_id]
    assert [event.type for event in events[:3]] == ["queued", "started", "succeeded"]
    queued, started, ended = [event.number for event in events[:3]]
    assert (numbers, heard[0]["event"], heard[0]["id"], heard[0]["retry"]) == ([queued], "job", str(queued), "1000")
    assert {block["id"] for block in heard[1:-1]} <= {str(queued), str(started)}
    assert (heard[-1]["event"], heard[-1]["id"], heard[-2]["id"]) == ("end", str(ended), str(started))


def test_wherever_a_stream_is_cut_the_final_state_comes_and_the_end_once(worker, job_id, seeded, store, settings):
    threading.Timer(0.3, worker.finish_calibration).start()
    whole = listen(seeded, job_id)
    stop_and_start(seeded, store, settings)
    again: dict[str | None, str] = {}
    for cut in range(len(whole) + 1):
        heard = blocks(whole[:cut])
        last_id = heard[-1]["id"] if heard else None
        if last_id not in again:
            again[last_id] = listen(seeded, job_id, last_id)
        heard += blocks(again[last_id])
        assert [block["event"] for block in heard].count("end") == 1, cut
        assert heard[-1]["event"] == "end", cut
        assert [block["data"] for block in heard if block["event"] == "job"][-1]["state"] == "succeeded", cut
    assert again[blocks(whole)[-1]["id"]] == ""


def test_a_running_job_is_sent_as_it_is_whatever_the_client_has_seen(seeded, store, worker, job_id, settings):
    """Progress has no event of its own: a client may hold the newest number and an older state."""
    claim = worker.claim()
    for fraction in (0.25, 0.5):
        store.jobs.heartbeat(claim, Progress(fraction=fraction, stage="search"))
        threading.Timer(0.2, seeded.app.state.stopping.begin).start()
        first, *_, closing = blocks(listen(seeded, job_id, str(store.events.numbers_of_job(job_id).latest)))
        assert (first["event"], first["data"]["progress"]["fraction"]) == ("job", fraction)
        assert (closing["event"], closing["id"], closing["retry"]) == ("closing", first["id"], "1000")
        stop_and_start(seeded, store, settings)


def test_a_job_that_ends_between_two_looks_has_the_number_of_its_end(seeded, store, worker, job_id):
    """Its numbers are read before its row."""

    class EndingFirst(Jobs):
        def get(self, job_id: str) -> Job:
            if super().get(job_id).state is JobState.QUEUED:
                worker.finish_calibration()
            return super().get(job_id)

    store.jobs = EndingFirst(store.database, store.files, MILL_SUBJECTS)
    *_, job, end = blocks(listen(seeded, job_id))
    latest, ended = store.events.numbers_of_job(job_id)
    assert (job["id"], end["id"]) == (str(latest), str(ended))


def test_an_id_never_given_is_one_of_before_and_the_first_versions_jobs_end_without_one(seeded, store, worker, job_id):
    for headers in ({}, {"Last-Event-ID": "0"}):
        job, end = blocks(seeded.get("/v1/jobs/example/events", headers=headers).text)
        assert (job["event"], end["event"], "id" in end) == ("job", "end", False)
    worker.finish_calibration()
    for other in ("0", str(store.events.newest_number() + 1)):
        assert [block["event"] for block in blocks(listen(seeded, job_id, other))] == ["job", "end"]
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
