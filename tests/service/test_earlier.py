"""A request that was answered before: what a program and a person see."""

import pytest
from documented import check_documented
from page_text import text_of

from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.storage.origins import origin_of
from sawmill_worker.storage.software import software

PLAN = {
    "scanner_id": "example",
    "views": 30,
    "theta": {
        "initial_angle_rad": 0.0,
        "detector_to_cor_mm": 740.0,
        "source_shift_mm": 200.0,
        "detector_shift_mm": 30.0,
        "detector_tilt": 0.2,
    },
}
ASKS = {
    "calibrations": ("/v1/calibrations", {"scan_id": "example"}, "finish_calibration"),
    "reconstructions": ("/v1/reconstructions", {"scan_id": "example", "size": 64}, "finish_reconstruction"),
    "drifts": ("/v1/drifts", {"scan_id": "example", "rows": "0:2"}, "finish_drift"),
    "plans": ("/v1/phantoms/l-shape/plans", PLAN, "finish_plan"),
}


@pytest.fixture
def worker(store, worker, monkeypatch):
    """One whose software is known."""
    succeed = store.jobs.succeed

    def with_origin(claim, result, output):
        origin = origin_of(claim.job.kind, store.jobs.handed_over(claim.job_id), software())
        succeed(claim, result, output, origin=origin)

    monkeypatch.setattr(store.jobs, "succeed", with_origin)
    return worker


@pytest.fixture
def answered(seeded, worker):
    """Ask twice; the first answer and the second."""

    def ask(plural):
        path, body, finish = ASKS[plural]
        first = seeded.post(path, json=body).json()
        getattr(worker, finish)()
        again = seeded.post(path, json=body)
        assert again.status_code == 202
        check_documented(again)
        return seeded.get(first["links"]["self"]).json(), again.json()

    return ask


@pytest.mark.parametrize("plural", ASKS)
def test_the_second_answer_has_the_result_at_once_and_says_whose(seeded, answered, plural):
    first, second = answered(plural)
    assert (first["state"], first["answered_from"]) == ("succeeded", None)
    assert (second["state"], second["answered_from"]) == ("succeeded", first["id"])
    own = {"id", "created_at", "job_id", "links", "answered_from"}
    assert {name: second[name] for name in second.keys() - own} == {name: first[name] for name in first.keys() - own}
    assert all(second[name] != first[name] for name in own)
    job = seeded.get(second["links"]["job"]).json()
    assert (job["state"], job["answered_from"], job["started_at"], job["attempt"]) == (
        "succeeded",
        first["id"],
        None,
        0,
    )
    assert job["finished_at"] is not None
    path, body, _ = ASKS[plural]
    fresh = seeded.post(path, json={**body, "fresh": True}).json()
    assert (fresh["state"], fresh["answered_from"]) == ("queued", None)
    assert "fresh" not in fresh["options"]


def test_the_files_of_the_second_answer_are_those_of_the_first(seeded, answered):
    first, second = answered("reconstructions")
    volumes = [seeded.get(each["links"]["volume"]) for each in (first, second)]
    assert volumes[0].content == volumes[1].content
    assert volumes[0].headers["ETag"] == volumes[1].headers["ETag"]
    assert seeded.get(second["links"]["first_slice"]).status_code == 200


def test_a_repeat_by_its_key_makes_no_second_answer(seeded, store, answered):
    answered("plans")
    path, body, _ = ASKS["plans"]
    answers = [seeded.post(path, json=body, headers={"Idempotency-Key": "a"}) for _ in range(2)]
    assert answers[0].json() == answers[1].json()
    assert answers[0].json()["state"] == "succeeded"
    assert len(store.jobs.page(kind=JobKind.PLAN).items) == 4, "the example's, two before, and one"


PAGES = {
    "calibrations": ("/calibrate?calibration={id}", "/calibrations/{id}/report"),
    "reconstructions": ("/logs/{id}", "/logs/{id}"),
    "plans": ("/phantoms/l-shape", "/v1/plans/{id}"),
}
SENTENCE = "Answered from an earlier result of the same input"


@pytest.mark.parametrize("plural", PAGES)
def test_people_see_where_a_result_is_from(seeded, answered, plural):
    page, earlier = PAGES[plural]
    first, second = answered(plural)
    shown = seeded.get(page.format(id=second["id"])).text
    assert SENTENCE in text_of(shown)
    assert f'href="{earlier.format(id=first["id"])}"' in shown
    jobs = seeded.get("/jobs").text
    assert text_of(jobs).count(SENTENCE) == 1
    assert f'href="{earlier.format(id=first["id"])}"' in jobs


def test_it_is_said_in_finnish_too(seeded, answered):
    _, second = answered("reconstructions")
    shown = seeded.get(f"/logs/{second['id']}", headers={"Accept-Language": "fi"}).text
    assert "Vastattu aiemmasta tuloksesta" in text_of(shown)
