import pytest

from sawmill_contracts import kinds

NOMINAL = {
    "initial_angle_rad": 0.0,
    "detector_to_cor_mm": 740.0,
    "source_shift_mm": 200.0,
    "detector_shift_mm": 30.0,
    "detector_tilt": 0.2,
}


def test_a_plan_is_accepted_and_answered_by_a_job(seeded, store, worker, woken):
    accepted = seeded.post("/v1/phantoms/l-shape/plans", json={"scanner_id": "example", "theta": NOMINAL, "views": 20})
    assert accepted.status_code == 202
    assert accepted.headers["Retry-After"] == "1"
    queued = seeded.get(accepted.headers["Location"]).json()
    assert (queued["state"], queued["options"]["views"], queued["options"]["noise"]) == ("queued", 20, 0.02)
    assert woken == [queued["job_id"]]
    assert store.jobs.get(queued["job_id"]).kind is kinds.PLAN
    worker.finish_plan()
    done = seeded.get(accepted.headers["Location"]).json()
    assert (done["state"], done["result"]["predicted_ray_error_mm"]["rms"]) == ("succeeded", 0.02)
    for link in done["links"].values():
        assert seeded.get(link).status_code == 200


def test_plans_are_listed_by_phantom(seeded):
    assert [item["id"] for item in seeded.get("/v1/plans?phantom_id=l-shape").json()["items"]] == ["example"]
    assert seeded.get("/v1/plans?phantom_id=rectangle-with-hole").json()["items"] == []


@pytest.mark.parametrize(
    ("phantom_id", "body", "status", "code"),
    [
        ("cube", {"scanner_id": "example"}, 404, "phantom-not-found"),
        ("l-shape", {"scanner_id": "line-9"}, 404, "scanner-not-found"),
        ("l-shape", {"scanner_id": "example-spare"}, 409, "no-active-calibration"),
        ("l-shape", {"scanner_id": "example", "noise": 0}, 422, "invalid-request"),
        ("l-shape", {"scanner_id": "example", "views": 2}, 422, "invalid-request"),
    ],
)
def test_what_cannot_be_planned_is_refused(seeded, phantom_id, body, status, code):
    answer = seeded.post(f"/v1/phantoms/{phantom_id}/plans", json=body)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
