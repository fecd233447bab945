"""The embedded service on a small disk that fills up and is cleared again."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from live_service import SCANNER, Service, stop_outside_a_transaction, wait_until, workers

from sawmill_tomography.geometry.geometry import Theta

pytestmark = pytest.mark.slow

DISK_MIB = 48
# In a mount namespace of its own: nothing stays mounted, however the test ends.
ON_A_SMALL_DISK = ["unshare", "--map-root-user", "--mount", "sh", "-c"]
MOUNT = f'mount -t tmpfs -o size={DISK_MIB}m tmpfs "$0"'


@pytest.fixture
def small_disk(tmp_path: Path) -> list[str]:
    """What to start a service with so that its data folder is a disk of its own."""
    folder = tmp_path / "data"
    folder.mkdir()
    tried = subprocess.run([*ON_A_SMALL_DISK, MOUNT, str(folder)], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"no disk can be mounted here, not even in a namespace of its own: {tried.stderr.strip()}")
    return [*ON_A_SMALL_DISK, f'{MOUNT} && exec "$@"', str(folder)]


def leave_free(ballast: Path, free_bytes: int) -> None:
    """Fill the disk up to this number of bytes."""
    with ballast.open("ab", buffering=0) as file:
        for size in (2**20, 2**12):
            with suppress(OSError):
                while True:
                    file.write(bytes(size))
        file.truncate(file.tell() - free_bytes)


def test_an_accepted_job_waits_for_room_and_the_worker_stays(tmp_path, offline, serve, small_disk, write_phantom_scan):
    write_phantom_scan(tmp_path / "scan.h5", Theta(0.7, 728.0, -254.0, -37.0, -0.21))
    environment = {**offline.variables, "SAWMILL_DISK_RESERVE_BYTES": "1000000", "SAWMILL_OUTAGE_WAIT_S": "0.2"}
    with serve(tmp_path, environment, "--no-examples", prefix=small_disk) as service:
        disk = Path(f"/proc/{service.process_id}/root{service.data}")
        spec = {"scanner_id": service.create_scanner(), "data": "counts", "phantom_id": "l-shape"}
        scan = service.upload((tmp_path / "scan.h5").read_bytes(), **spec)
        service.wait(scan["job_id"])
        (worker,) = workers(service.process_id)
        stop_outside_a_transaction(worker, disk / "sawmill.db")  # so that the job is accepted before the disk is full
        job_id = service.post("/v1/calibrations", json={"scan_id": scan["id"]})["job_id"]
        leave_free(disk / "ballast", 0)
        os.kill(worker, signal.SIGCONT)

        def job() -> dict[str, Any]:
            found = service.get(f"/v1/jobs/{job_id}").json()
            assert found["state"] in {"queued", "running"}, found
            assert found["losses"] == 0
            return found

        ready = service.client.get("/health/ready")
        assert (ready.status_code, ready.json()["state"]) == (503, "disk-full")
        assert service.client.post("/v1/scans", params=spec, content=bytes(2**16)).status_code == 507
        time.sleep(1.0)
        assert job()["attempt"] <= 1, "not even a claim can be written"

        reasons = set()
        deadline = time.monotonic() + 120
        while job()["attempt"] <= 3:
            assert time.monotonic() < deadline, job()
            leave_free(disk / "ballast", 120_000)  # room for rows, and none for results
            if (reason := job()["waiting_for"]) is not None:
                reasons.add(reason["code"])
            time.sleep(0.1)
        assert reasons == {"storage-full"}
        assert workers(service.process_id) == {worker}

        (disk / "ballast").unlink()
        assert service.wait(job_id)["state"] == "succeeded"
        assert service.get("/health/ready").json()["state"] == "ready"
        assert list((disk / "attempts").iterdir()) == []


@pytest.mark.nightly
def test_a_running_and_a_waiting_job_are_cancelled_on_a_full_disk(
    tmp_path, offline, serve, small_disk, write_phantom_scan
):
    write_phantom_scan(tmp_path / "scan.h5", Theta(0.7, 728.0, -254.0, -37.0, -0.21))
    environment = {**offline.variables, "SAWMILL_DISK_RESERVE_BYTES": "1000000", "SAWMILL_OUTAGE_WAIT_S": "0.2"}
    with serve(tmp_path, environment, "--no-examples", prefix=small_disk) as service:
        disk = Path(f"/proc/{service.process_id}/root{service.data}")
        scanner_id = service.create_scanner()
        content = (tmp_path / "scan.h5").read_bytes()
        scan = service.upload(content, scanner_id=scanner_id, data="counts", phantom_id="l-shape")
        service.wait(scan["job_id"])
        wait_until((disk / "sawmill.db.spare").exists)
        ask = {"scan_id": scan["id"], "method": "paper", "paper": {"max_generations": 1000}}
        jobs = [service.post("/v1/calibrations", json=ask | {"seed": seed})["job_id"] for seed in range(2)]
        wait_until(lambda: service.get(f"/v1/jobs/{jobs[0]}").json()["progress"])
        leave_free(disk / "ballast", 0)
        # The write-ahead log may have pages that are free still.
        wait_until(lambda: rename(service, scanner_id).status_code == 507)
        for job_id in reversed(jobs):
            # As a page sends it, and as a program does.
            headers = {"Idempotency-Key": job_id} if job_id == jobs[0] else {}
            service.post(f"/v1/jobs/{job_id}/cancel", headers=headers)
            assert service.wait(job_id)["state"] == "cancelled"
        assert (disk / "ballast").exists()


def rename(service: Service, scanner_id: str) -> httpx.Response:
    scanner = {"name": str(time.monotonic()), "constants": vars(SCANNER)}
    return service.client.put(f"/v1/scanners/{scanner_id}", json=scanner)
