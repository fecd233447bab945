"""A service and its workers on PostgreSQL, which comes late, pauses, and is killed in the middle of a job."""

import signal
import subprocess
import sys
import threading

import pytest
from emptied_databases import own_server
from live_service import SCANNER, serving, wait_until
from missing_parts import first_by_day

from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_tomography.geometry.geometry import Theta
from sawmill_tomography.geometry.ray_error import ray_error

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0
THETA = Theta(0.7, 728.0, -254.0, -37.0, -0.21)
PROCESSES = {
    "serve": ["sawmill_command.commands", "serve", "--no-examples", "--port", "0"],
    "worker": ["sawmill_worker.poller"],
    "celery": ["celery", "-A", "sawmill_worker.celery_app", "worker"],
}


@pytest.fixture(scope="module")
def postgres():
    """A server that is stopped, which others must not notice."""
    with own_server() as server:
        yield server


def refused(service, method, path, **options):
    """Whether a request is answered as it should be, and so before the database is back."""
    response = service.client.request(method, path, **options)
    answered = response.status_code, response.json()["code"], int(response.headers["retry-after"]) > 0
    return answered == (503, "storage-unavailable", True)


def test_a_calibration_outlives_a_late_a_paused_and_a_killed_server(
    tmp_path, offline, postgres, postgres_url, phantom_scan
):
    postgres.stop()
    log = tmp_path / "service.log"

    def start_when_awaited():
        wait_until(lambda: log.exists() and "database-awaited" in log.read_text())
        postgres.start()

    late = threading.Thread(target=start_when_awaited)
    late.start()
    environment = {**offline.variables, "SAWMILL_DATABASE_URL": postgres_url}
    with serving(tmp_path, environment, "--no-examples", "--workers", "1") as service:
        late.join()
        with postgres.paused():
            assert refused(service, "GET", "/health/ready")
            assert refused(service, "POST", "/v1/scanners", json={"name": "Line 3", "constants": vars(SCANNER)})
        wait_until(lambda: service.client.get("/health/ready").is_success)
        scan = service.upload_phantom(phantom_scan(views=180, seed=41))
        asked = service.post("/v1/calibrations", json={"scan_id": scan["id"]})
        wait_until(lambda: service.get(f"/v1/jobs/{asked['job_id']}").json()["state"] != "queued")
        postgres.stop(signal.SIGKILL)
        assert refused(service, "GET", "/health/ready")
        assert refused(service, "GET", f"/v1/jobs/{asked['job_id']}")
        postgres.start()
        wait_until(lambda: service.client.get("/health/ready").is_success)
        ended = service.wait(asked["job_id"])
        found = CalibrationSucceeded.model_validate(service.get(f"/v1/calibrations/{asked['id']}").json())
    assert (ended["state"], ended["losses"]) == ("succeeded", 0)
    truth = THETA.source_frame(SCANNER.source_to_cor_mm)
    # The limit of the same job without disturbance.
    assert ray_error(SCANNER, truth, found.source_frame).rms_mm < 0.05


@pytest.fixture(params=first_by_day(1, PROCESSES))
def start(request, tmp_path, offline):
    """Start a process that needs the database; its exit code and its log are what is asked of it."""

    def run(url: str) -> subprocess.Popen[str]:
        given = {"SAWMILL_DATABASE_URL": url, "SAWMILL_DATA_FOLDER": str(tmp_path / "data")}
        if request.param == "celery":
            given["SAWMILL_BROKER_URL"] = request.getfixturevalue("redis_url")
        command = [sys.executable, "-m", *PROCESSES[request.param]]
        return subprocess.Popen(command, env={**offline.variables, **given}, stderr=subprocess.PIPE, text=True)

    return run


def test_every_process_waits_for_a_server_and_ends_when_it_is_asked_to(start):
    process = start("postgresql://postgres@127.0.0.1:1/sawmill")
    assert "Connection refused" in next(line for line in process.stderr if "database-awaited" in line)
    process.terminate()
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0


def test_every_process_says_at_once_that_there_is_no_such_database(start, postgres):
    process = start(postgres.url("nowhere"))
    _, log = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert 'database "nowhere" does not exist' in " ".join(log.split())
    assert "Traceback" not in log
