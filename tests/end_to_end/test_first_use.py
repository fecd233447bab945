"""A fresh data folder whose examples are still being computed, and a user who does not wait for them."""

import time

import pytest

from sawmill_worker.tomography.geometry import Theta

pytestmark = pytest.mark.slow

QUEUED_S = 30.0


@pytest.mark.timeout(180)
def test_a_first_calibration_does_not_wait_for_the_examples(tmp_path, offline, serve, write_phantom_scan):
    write_phantom_scan(tmp_path / "scan.h5", Theta(0.7, 728.0, -254.0, -37.0, -0.21))
    with serve(tmp_path, {**offline.variables, "SAWMILL_STOP_GRACE_S": "1"}) as service:
        deadline = time.monotonic() + QUEUED_S
        while service.client.get("/v1/plans/example").status_code != 200:  # the last of them to be queued
            assert time.monotonic() < deadline
            time.sleep(0.05)
        scan = service.upload(
            (tmp_path / "scan.h5").read_bytes(),
            scanner_id=service.create_scanner(),
            data="counts",
            phantom_id="l-shape",
        )
        asked = service.post("/v1/calibrations", json={"scan_id": scan["id"]})
        mine = service.wait(asked["job_id"])
        jobs = service.get("/v1/jobs").json()["items"]
    examples = [job for job in jobs if job["background"]]
    assert mine["state"] == "succeeded"
    assert len(examples) >= 4
    begun = [job for job in examples if job["started_at"] and job["started_at"] > scan["created_at"]]
    assert all(job["started_at"] > mine["finished_at"] for job in begun), "they come after what a user asked for"
    assert any(not job["finished_at"] for job in examples), "they were not done before it"
