"""On one machine a person's calibration waits for no reconstruction of minutes."""

import time

import pytest

pytestmark = pytest.mark.slow

# Four slices of a million pixels, fitted to 180 views: half a minute at least.
LONG = {"method": "total_variation", "size": 1024}


def state(service, job_id):
    return service.get(f"/v1/jobs/{job_id}").json()["state"]


@pytest.mark.timeout(180)
def test_a_calibration_is_done_while_a_long_reconstruction_runs(tmp_path, offline, serve, mill_scan):
    with serve(tmp_path, offline.variables, "--no-examples") as service:
        kind = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": "0:2"}
        scan = service.upload(mill_scan.path.read_bytes(), scanner_id=service.create_scanner(), **kind)
        assert service.wait(scan["job_id"])["state"] == "succeeded"
        long = service.post("/v1/reconstructions", json=LONG | {"scan_id": scan["id"], "theta": vars(mill_scan.theta)})[
            "job_id"
        ]
        while state(service, long) == "queued":
            time.sleep(0.05)
        begun = time.monotonic()
        asked = service.post("/v1/calibrations", json={"scan_id": scan["id"]})
        calibration = service.wait(asked["job_id"])
        took_s = time.monotonic() - begun
        still = service.get(f"/v1/jobs/{long}").json()
        assert (calibration["state"], calibration["short"]) == ("succeeded", True)
        assert (still["state"], still["short"]) == ("running", False), (took_s, still)
        assert calibration["worker"] != still["worker"]
        service.post(f"/v1/jobs/{long}/cancel")
        assert service.wait(long)["state"] == "cancelled"
