import pytest


def test_a_look_at_drift_is_accepted_waited_for_and_answered(seeded, worker, woken):
    accepted = seeded.post("/v1/drifts", json={"scan_id": "example", "rows": "0:2"})
    assert accepted.status_code == 202
    assert accepted.headers["Retry-After"] == "1"
    path = accepted.headers["Location"]
    queued = seeded.get(path).json()
    assert (queued["state"], queued["calibration_id"], queued["options"]["rows"]) == ("queued", "example", "0:2")
    assert woken == [queued["job_id"]]
    worker.finish_drift()
    answer = seeded.get(path).json()
    assert (answer["state"], answer["result"]["within_tolerance"]) == ("succeeded", True)
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


@pytest.mark.parametrize(
    ("ask", "status", "code"),
    [
        ({"scan_id": "nothing"}, 404, "scan-not-found"),
        ({"scan_id": "example", "calibration_id": "nothing"}, 404, "calibration-not-found"),
        ({}, 422, "invalid-request"),
        ({"scan_id": "example", "row": "0:1"}, 422, "invalid-request"),
        ({"scan_id": "example", "rows": "4:4"}, 422, "invalid-request"),
    ],
)
def test_what_cannot_be_looked_at_is_a_problem(seeded, woken, ask, status, code):
    answer = seeded.post("/v1/drifts", json=ask)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert woken == []


def test_they_are_listed_by_scanner_and_state(seeded):
    seeded.post("/v1/drifts", json={"scan_id": "example"})
    listed = {state: seeded.get(f"/v1/drifts?state={state}").json()["items"] for state in ("queued", "succeeded")}
    assert [item["id"] for item in listed["succeeded"]] == ["example"]
    assert listed["succeeded"][0]["links"]["self"] == "/v1/drifts/example"
    assert len(listed["queued"]) == 1
    assert seeded.get("/v1/drifts?scanner_id=example-spare").json()["items"] == []
    assert seeded.get("/v1/jobs?kind=drift").json()["items"][0]["kind"] == "drift"
