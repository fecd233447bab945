import h5py
import pytest


def test_a_calibration_is_accepted_waited_for_and_answered(seeded, worker, woken):
    accepted = seeded.post("/v1/calibrations", json={"scan_id": "example", "seed": 11})
    assert accepted.status_code == 202
    path = accepted.headers["Location"]
    queued = seeded.get(path).json()
    assert (queued["state"], queued["phantom_id"], queued["options"]["seed"]) == ("queued", "l-shape", 11)
    assert woken == [queued["job_id"]]
    assert seeded.get(queued["links"]["report"]).json()["code"] == "calibration-without-result"
    worker.finish_calibration()
    answer = seeded.get(path).json()
    assert (answer["state"], answer["verdict"], answer["source_frame"]["source_distance_mm"]) == (
        "succeeded",
        "pass",
        917.1,
    )
    for link in answer["links"].values():
        assert seeded.get(link).status_code == 200


def test_the_files_are_what_the_job_wrote(seeded, tmp_path):
    answer = seeded.get("/v1/calibrations/example/result.h5")
    (tmp_path / "copy.h5").write_bytes(answer.content)
    with h5py.File(tmp_path / "copy.h5") as file:
        assert file["gain"][()] == 1.0
    assert 'filename="calibration-example.h5"' in answer.headers["Content-Disposition"]
    held = {"If-None-Match": answer.headers["ETag"]}
    assert seeded.get("/v1/calibrations/example/result.h5", headers=held).status_code == 304


@pytest.mark.parametrize(
    ("ask", "status", "code"),
    [
        ({"scan_id": "nothing"}, 404, "scan-not-found"),
        ({"scan_id": "example", "phantom_id": "nothing"}, 404, "phantom-not-found"),
        ({}, 422, "invalid-request"),
        ({"scan_id": "example", "sead": 1}, 422, "invalid-request"),
        ({"scan_id": "example", "rows": "4:4"}, 422, "invalid-request"),
        ({"scan_id": "example", "views": 2}, 422, "invalid-request"),
    ],
)
def test_a_calibration_that_cannot_be_is_a_problem(seeded, woken, ask, status, code):
    answer = seeded.post("/v1/calibrations", json=ask)
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert woken == []


def test_a_calibration_may_be_asked_for_while_its_scan_is_read(seeded):
    upload = "/v1/scans?scanner_id=example&data=counts&phantom_id=l-shape"
    scan = seeded.post(upload, content=b"x").json()
    assert seeded.post("/v1/calibrations", json={"scan_id": scan["id"]}).status_code == 202


def test_activating_an_older_one_rolls_back(seeded, worker):
    newer = seeded.post("/v1/calibrations", json={"scan_id": "example", "activate": True}).json()["id"]
    worker.finish_calibration()
    assert seeded.get("/v1/scanners/example").json()["active_calibration_id"] == newer
    answer = seeded.post("/v1/calibrations/example/activate", json={"reason": "the new one blurs"})
    assert answer.json()["active_calibration_id"] == "example"
    assert seeded.get("/v1/scanners/example/history").json()[0]["reason"] == "the new one blurs"


def test_activating_needs_no_body(seeded):
    assert seeded.post("/v1/calibrations/example/activate").status_code == 200


def test_an_unfinished_calibration_cannot_be_activated(seeded):
    path = seeded.post("/v1/calibrations", json={"scan_id": "example"}).headers["Location"]
    assert seeded.post(f"{path}/activate").status_code == 409


def test_calibrations_are_listed_by_scanner_and_state(seeded):
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    listed = {state: seeded.get(f"/v1/calibrations?state={state}").json()["items"] for state in ("queued", "succeeded")}
    assert [item["id"] for item in listed["succeeded"]] == ["example"]
    assert listed["succeeded"][0]["links"]["self"] == "/v1/calibrations/example"
    assert len(listed["queued"]) == 1
    assert seeded.get("/v1/calibrations?scanner_id=example-spare").json()["items"] == []
