"""On one machine a person's calibration waits for no reconstruction of minutes."""

import time

import pytest

pytestmark = pytest.mark.slow

# Four slices of a million pixels, fitted to 180 views: half a minute at least.
LONG = {"method": "total_variation", "size": 1024}


def state(service, job_id):
    return service.get(f"/v1/jobs/{job_id}").json()["state"]


@pytest.mark.timeout(180)
def test_a_calibration_is_done_while_a_long_reconstruction_runs(embedded, mill_scan):
    kind = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": "0:2"}
    scan = embedded.upload(mill_scan.path.read_bytes(), scanner_id=embedded.create_scanner(), **kind)
    assert embedded.wait(scan["job_id"])["state"] == "succeeded"
    asked = LONG | {"scan_id": scan["id"], "theta": vars(mill_scan.theta)}
    long = embedded.post("/v1/reconstructions", json=asked)["job_id"]
    while state(embedded, long) == "queued":
        time.sleep(0.05)
    begun = time.monotonic()
    asked = embedded.post("/v1/calibrations", json={"scan_id": scan["id"]})
    calibration = embedded.wait(asked["job_id"])
    took_s = time.monotonic() - begun
    still = embedded.get(f"/v1/jobs/{long}").json()
    assert (calibration["state"], calibration["short"]) == ("succeeded", True)
    assert (still["state"], still["short"]) == ("running", False), (took_s, still)
    assert calibration["worker"] != still["worker"]
    embedded.post(f"/v1/jobs/{long}/cancel")
    assert embedded.wait(long)["state"] == "cancelled"
