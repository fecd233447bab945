"""On one machine a person's calibration waits for no reconstruction of minutes."""

import os
import signal
from contextlib import suppress

import pytest
from live_service import descendants, wait_until

pytestmark = pytest.mark.slow

# Four slices of a million pixels, fitted to 180 views: half a minute at least.
LONG = {"method": "total_variation", "size": 1024}


def job(service, job_id):
    return service.get(f"/v1/jobs/{job_id}").json()


def test_a_calibration_is_done_while_a_long_reconstruction_runs(embedded, mill_scan):
    kind = {"data": "counts", "phantom_id": "l-shape", "phantom_rows": "0:2"}
    scan = embedded.upload(mill_scan.path.read_bytes(), scanner_id=embedded.create_scanner(), **kind)
    assert embedded.wait(scan["job_id"])["state"] == "succeeded"
    asked = LONG | {"scan_id": scan["id"], "theta": vars(mill_scan.theta)}
    long = embedded.post("/v1/reconstructions", json=asked)["job_id"]
    wait_until(lambda: job(embedded, long)["state"] != "queued")
    worker = int(job(embedded, long)["worker"].rpartition("-")[2])
    # The attempt, which so outlasts a calibration on any machine, and the spare process; not what forks attempts.
    stopped = [process for process in descendants(worker) if descendants(process) == {process}]
    for process in stopped:
        os.kill(process, signal.SIGSTOP)
    asked = embedded.post("/v1/calibrations", json={"scan_id": scan["id"]})
    calibration = embedded.wait(asked["job_id"])
    still = job(embedded, long)
    assert (calibration["state"], calibration["short"]) == ("succeeded", True)
    assert (still["state"], still["short"]) == ("running", False), still
    assert calibration["worker"] != still["worker"]
    embedded.post(f"/v1/jobs/{long}/cancel")
    assert embedded.wait(long)["state"] == "cancelled"
    for process in stopped:  # a later test's job would wait a minute for the spare process
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)
