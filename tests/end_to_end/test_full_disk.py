"""A data folder on a small disk that fills up, and on a mount that goes and comes back."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from live_service import SCANNER, Service, process, serving, stop_outside_a_transaction, wait_until, workers

pytestmark = pytest.mark.slow

# In a mount namespace of its own: nothing stays mounted, however the test ends.
ON_A_SMALL_DISK = ["unshare", "--map-root-user", "--mount", "sh", "-c"]
MOUNT = 'mount -t tmpfs -o size=48m tmpfs "$0"'


@pytest.fixture
def on_small_disk(tmp_path, offline):
    """Start a service whose data folder is a disk of its own; give it and the folder as this process reaches it."""
    folder = tmp_path / "data"
    folder.mkdir()
    skip_unless_mounted([*ON_A_SMALL_DISK, MOUNT, str(folder)])
    environment = {**offline.variables, "SAWMILL_DISK_RESERVE_BYTES": "1000000", "SAWMILL_OUTAGE_WAIT_S": "0.2"}
    prefix = [*ON_A_SMALL_DISK, f'{MOUNT} && exec "$@"', str(folder)]

    @contextmanager
    def start() -> Iterator[tuple[Service, Path]]:
        with serving(tmp_path, environment, "--no-examples", prefix=prefix) as service:
            yield service, Path(f"/proc/{service.process_id}/root{service.data}")

    return start


def skip_unless_mounted(command: list[str]) -> None:
    tried = subprocess.run(command, capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"no disk can be mounted here, not even in a namespace of its own: {tried.stderr.strip()}")


def leave_free(ballast: Path, free_bytes: int) -> None:
    with ballast.open("ab", buffering=0) as file:
        for size in (2**20, 2**12):
            with suppress(OSError):
                while True:
                    file.write(bytes(size))
        file.truncate(file.tell() - free_bytes)


def test_an_accepted_job_waits_for_room_and_the_worker_stays(on_small_disk, phantom_scan):
    with on_small_disk() as (service, disk):
        scan = service.upload_phantom(phantom_scan())
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
        spec = {"scanner_id": scan["scanner_id"], "data": "counts"}
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
def test_a_running_and_a_waiting_job_are_cancelled_on_a_full_disk(on_small_disk, phantom_scan):
    with on_small_disk() as (service, disk):
        scan = service.upload_phantom(phantom_scan())
        service.wait(scan["job_id"])
        wait_until((disk / "sawmill.db.spare").exists)
        ask = {"scan_id": scan["id"], "method": "paper", "paper": {"max_generations": 1000}}
        jobs = [service.post("/v1/calibrations", json=ask | {"seed": seed})["job_id"] for seed in range(2)]
        wait_until(lambda: service.get(f"/v1/jobs/{jobs[0]}").json()["progress"])
        leave_free(disk / "ballast", 0)
        # The write-ahead log may have pages that are free still.
        wait_until(lambda: rename(service, scan["scanner_id"]).status_code == 507)
        for job_id in reversed(jobs):
            # As a page sends it, and as a program does.
            headers = {"Idempotency-Key": job_id} if job_id == jobs[0] else {}
            service.post(f"/v1/jobs/{job_id}/cancel", headers=headers)
            assert service.wait(job_id)["state"] == "cancelled"
        assert (disk / "ballast").exists()


def rename(service: Service, scanner_id: str) -> httpx.Response:
    scanner = {"name": str(time.monotonic()), "constants": vars(SCANNER)}
    return service.client.put(f"/v1/scanners/{scanner_id}", json=scanner)


# In a mount namespace of its own: the service's folder stays as it is, and nothing stays mounted.
ELSEWHERE = ["unshare", "--map-root-user", "--mount"]
WORKER = [sys.executable, "-m", "sawmill_command.commands", "worker"]
JOBS = 6


@pytest.fixture
def elsewhere(tmp_path, offline, postgres_url):
    """Start a worker whose data folder is the mount point `share`; what is called mounts there as a command says."""
    share = tmp_path / "share"
    share.mkdir()
    skip_unless_mounted([*ELSEWHERE, "mount", "--bind", str(tmp_path), str(share)])

    @contextmanager
    def start():
        given = {"SAWMILL_DATABASE_URL": postgres_url, "SAWMILL_DATA_FOLDER": str(share), "SAWMILL_OUTAGE_WAIT_S": "1"}
        with process([*ELSEWHERE, *WORKER], {**offline.variables, **given}, tmp_path / "worker.log") as worker:
            within = ["nsenter", "--target", str(worker.pid), "--user", "--preserve-credentials", "--mount"]

            def mount(*command: str) -> None:
                # What is being written keeps a mount from becoming read-only for a moment.
                wait_until(lambda: subprocess.run([*within, *command], check=False, timeout=60).returncode == 0)

            yield worker, mount

    return start


@pytest.mark.nightly
def test_jobs_wait_for_a_mount_that_comes_and_goes_and_none_is_lost(
    tmp_path, offline, postgres_url, elsewhere, phantom_scan
):
    """A worker of another machine, whose mount of the data folder is missing, goes, comes back or is read-only."""
    share, log = tmp_path / "share", tmp_path / "worker.log"
    environment = {**offline.variables, "SAWMILL_DATABASE_URL": postgres_url}
    with serving(tmp_path, environment, "--no-examples", "--workers", "0") as service:

        def ask(number: int) -> list[str]:
            return [service.post("/v1/calibrations", json={"scan_id": scan["id"]})["job_id"] for _ in range(number)]

        def states(job_ids: list[str]) -> Counter[str]:
            return Counter(service.get(f"/v1/jobs/{job_id}").json()["state"] for job_id in job_ids)

        scan = service.upload_phantom(phantom_scan())
        with elsewhere() as (worker, mount):
            wait_until(lambda: "data-folder-awaited" in log.read_text())
            assert service.get(f"/v1/jobs/{scan['job_id']}").json()["attempt"] == 0
            mount("mount", "--bind", str(service.data), str(share))
            assert service.wait(scan["job_id"])["state"] == "succeeded"
            jobs = []
            for away, back in (
                (["umount", "--lazy", str(share)], ["mount", "--bind", str(service.data), str(share)]),
                (["mount", "-o", "remount,ro,bind", str(share)], ["mount", "-o", "remount,rw,bind", str(share)]),
            ) * 2:
                asked = ask(JOBS)
                jobs += asked
                wait_until(lambda asked=asked: states(asked)["running"] or states(asked)["succeeded"])
                # A claim, or the end of a job that was done already.
                said = log.read_text().count("-put-off ")
                mount(*away)
                wait_until(lambda said=said: log.read_text().count("-put-off ") > said)
                assert states(asked)["failed"] == 0
                mount(*back)
                for job_id in asked:
                    service.wait(job_id)
            ended = [service.get(f"/v1/jobs/{job_id}").json() for job_id in jobs]
            assert worker.poll() is None
        assert list(share.iterdir()) == []
    assert {(job["state"], job["losses"]) for job in ended} == {("succeeded", 0)}
