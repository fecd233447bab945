"""A worker of another machine whose mount of the data folder is missing, goes, comes back and becomes read-only."""

import subprocess
import sys
from collections import Counter
from contextlib import contextmanager

import pytest
from live_service import process, wait_until

from sawmill_tomography.geometry.geometry import Theta

pytestmark = [pytest.mark.slow, pytest.mark.nightly]

# In a mount namespace of its own: the service's folder stays as it is, and nothing stays mounted.
ELSEWHERE = ["unshare", "--map-root-user", "--mount"]
WORKER = [sys.executable, "-m", "sawmill_command.commands", "worker"]
JOBS = 6


@pytest.fixture
def elsewhere(tmp_path, offline, postgres_url):
    """Start a worker whose data folder is the mount point `share`; what is called mounts there as a command says."""
    share = tmp_path / "share"
    share.mkdir()
    tried = subprocess.run(
        [*ELSEWHERE, "mount", "--bind", str(tmp_path), str(share)], capture_output=True, text=True, check=False
    )
    if tried.returncode:
        pytest.skip(f"nothing can be mounted here, not even in a namespace of its own: {tried.stderr.strip()}")

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


def test_jobs_wait_for_a_mount_that_comes_and_goes_and_none_is_lost(
    tmp_path, offline, serve, postgres_url, elsewhere, write_phantom_scan
):
    write_phantom_scan(tmp_path / "scan.h5", Theta(0.7, 728.0, -254.0, -37.0, -0.21))
    share, log = tmp_path / "share", tmp_path / "worker.log"
    environment = {**offline.variables, "SAWMILL_DATABASE_URL": postgres_url}
    with serve(tmp_path, environment, "--no-examples", "--workers", "0") as service:

        def ask(number: int) -> list[str]:
            return [service.post("/v1/calibrations", json={"scan_id": scan["id"]})["job_id"] for _ in range(number)]

        def states(job_ids: list[str]) -> Counter[str]:
            return Counter(service.get(f"/v1/jobs/{job_id}").json()["state"] for job_id in job_ids)

        spec = {"scanner_id": service.create_scanner(), "data": "counts", "phantom_id": "l-shape"}
        scan = service.upload((tmp_path / "scan.h5").read_bytes(), **spec)
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
