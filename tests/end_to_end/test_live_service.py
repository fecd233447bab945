"""One embedded service with its examples, driven as the console, a careless client and the mill's clock drive it."""

import hashlib
import io
import json
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from documented import add_what_is_decided, with_file
from live_service import Offline, serving, stop_outside_a_transaction, wait_until, workers

from sawmill_contracts.schedules import ScheduleSpec
from sawmill_platform.backups.backup import Backup
from sawmill_platform.backups.restoring import restore
from sawmill_platform.backups.taking import take_backup
from sawmill_platform.settings import StorageSettings
from sawmill_store.mill_files import NAMED_FOLDERS
from sawmill_store.store import Store
from sawmill_tomography.geometry.geometry import Theta

pytestmark = pytest.mark.slow

REQUESTS = Path(__file__).parents[2] / "openapi" / "requests"
# Two scans, a calibration, two reconstructions, a drift check and a plan.
EXAMPLE_JOBS = 7


@pytest.fixture(scope="module")
def live(tmp_path_factory, offline):
    """One embedded service for this module's tests, with its examples and one worker."""
    with serving(tmp_path_factory.mktemp("live"), offline.variables, "--workers", "1") as service:
        yield service


@pytest.fixture(scope="module")
def first(live, phantom_scan):
    """All jobs as they were when a user's first calibration had been done, asked for while the examples waited."""
    (worker,) = workers(live.process_id)
    stop_outside_a_transaction(worker, live.data / "sawmill.db")  # the examples wait however long it takes to ask
    wait_until(lambda: live.client.get("/v1/plans/example").status_code == 200)  # the last of them to be queued
    scan = live.upload_phantom(phantom_scan())
    asked = live.post("/v1/calibrations", json={"scan_id": scan["id"]})
    os.kill(worker, signal.SIGCONT)
    return scan, live.wait(asked["job_id"]), live.get("/v1/jobs").json()["items"]


def test_a_first_calibration_does_not_wait_for_the_examples(first):
    scan, mine, jobs = first
    examples = [job for job in jobs if job["background"]]
    assert mine["state"] == "succeeded"
    assert len(examples) >= 4
    begun = [job for job in examples if job["started_at"] and job["started_at"] > scan["created_at"]]
    assert all(job["started_at"] > mine["finished_at"] for job in begun), "they come after what a user asked for"


@pytest.fixture(scope="module")
def seeded(live, first):
    """The live service once its examples are computed, all of them: what a test asks for goes before the rest."""
    _, _, jobs = first
    examples = [live.wait(job["id"]) for job in reversed(jobs) if job["background"]]  # the oldest first, as they run
    assert len(examples) >= EXAMPLE_JOBS
    assert {job["state"] for job in examples} == {"succeeded"}
    return live


@pytest.fixture(scope="module")
def to_decide(seeded):
    """An alarm and a calibration in the live service that somebody may decide about."""
    with closing(Store(StorageSettings(data_folder=seeded.data, database_url=None))) as store:
        add_what_is_decided(store)


# What deletes an example comes after what needs it. Nothing may be sent from here, so that there are no webhooks:
# tests/service/test_openapi.py tries theirs where there is one.
IN_ORDER = sorted(
    (path for path in REQUESTS.glob("*.json") if not json.loads(path.read_text())["path"].startswith("/v1/webhooks")),
    key=lambda path: (path.stem.startswith("delete"), path.stem),
)


# By day the whole job of other tests asks for these, and tests/service/test_openapi.py sends every request.
@pytest.mark.nightly
@pytest.mark.parametrize("path", IN_ORDER, ids=lambda path: path.stem)
@pytest.mark.usefixtures("to_decide")
def test_the_console_can_try_every_operation(seeded, path):
    example = json.loads(path.read_text())
    options = {"params": example["query"], "headers": example["headers"]}
    if example["body_file"]:
        options |= with_file(example, seeded.get(example["body_file"]).content)
    elif example["media_type"]:
        options["json"] = example["body"]
    # The examples hold no key: one that nobody has would guard nothing.
    key = seeded.post("/v1/keys", json={"name": "example", "scope": "read"})["id"]
    asked = example["path"].replace("/v1/keys/example", f"/v1/keys/{key}")
    answer = seeded.client.request(example["method"], asked, **options)
    assert answer.is_success, answer.text
    if answer.status_code == 202 and "job_id" in answer.json():
        job = seeded.wait(answer.json()["job_id"])
        assert job["state"] == "succeeded", job


def without_angles() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.ones((12, 1, 512), np.float32))
    return buffer.getvalue()


# One of each kind; tests/formats/input has the others, without a service.
@pytest.mark.parametrize(
    ("content", "spec"), [(b"this is no scan", {"angles_deg": "0:30"}), (without_angles(), {})], ids=["text", "npy"]
)
def test_a_broken_upload_is_refused_with_a_sentence_and_leaves_nothing_behind(live, content, spec):
    scan = live.upload(content, scanner_id=live.create_scanner(), data="line-integrals", **spec)
    job = live.wait(scan["job_id"])
    assert (job["state"], job["failure"]["kind"], job["attempt"]) == ("failed", "input", 1), job
    refused = live.get(f"/v1/scans/{scan['id']}").json()
    assert (refused["state"], refused["reason"]) == ("refused", job["failure"]["detail"])
    assert len(refused["reason"].split()) > 5
    assert "Error" not in refused["reason"]
    assert live.client.get(f"/v1/scans/{scan['id']}/preview").status_code == 409
    left = [path for path in live.data.rglob("*") if scan["id"] in str(path) or scan["job_id"] in str(path)]
    assert {path.name for path in left if path.is_file()} <= {"original"}


@pytest.fixture
def mill(live):
    """The live service's data under a clock of the test's own: (store, clock)."""
    clock = SimpleNamespace(time=datetime(2031, 3, 3, 5, 29, tzinfo=UTC))
    with closing(Store(StorageSettings(data_folder=live.data, database_url=None), clock=lambda: clock.time)) as store:
        yield store, clock


def test_scheduled_recalibrations_tell_what_moved(live, mill, phantom_scan):
    store, clock = mill
    scanner_id = live.create_scanner(name="watched")
    as_built = Theta(0.7, 728.0, -254.0, -37.0, -0.21)
    knocked = Theta(0.7, 728.0, -254.0, -39.0, -0.21)

    def scanned(theta: Theta, seed: int) -> str:
        scan = live.upload_phantom(phantom_scan(theta, seed=seed), scanner_id)
        assert live.wait(scan["job_id"])["state"] == "succeeded"
        return scan["id"]

    first = live.post("/v1/calibrations", json={"scan_id": scanned(as_built, 1), "activate": True})
    assert live.wait(first["job_id"])["state"] == "succeeded"
    schedule = store.schedules.create(ScheduleSpec(scanner_id=scanner_id, cron="30 5 * * *"))

    def next_morning() -> list:
        clock.time += timedelta(days=1)
        return [run for run in store.schedules.run_due() if run.due_at <= clock.time]

    def compared() -> dict:
        (run,) = next_morning()
        assert run.outcome == "queued"
        assert store.schedules.run_due() == []
        calibration = live.get(f"/v1/calibrations/{run.calibration_id}").json()
        assert calibration["schedule_id"] == schedule.id
        assert live.wait(calibration["job_id"])["state"] == "succeeded"
        return live.get(f"/v1/calibrations/{run.calibration_id}").json()["comparison"]

    scanned(as_built, 2)
    unmoved = compared()
    assert unmoved["calibration_id"] == first["id"]
    assert unmoved["within_tolerance"]
    assert unmoved["ray_change_mm"] < 0.05
    (idle,) = next_morning()
    assert idle.outcome == "no-new-phantom-scan"
    scanned(knocked, 3)
    moved = compared()
    assert not moved["within_tolerance"]
    assert moved["ray_change_mm"] > 0.5
    assert "The rays moved" in moved["reason"]
    assert live.get(f"/v1/scanners/{scanner_id}").json()["active_calibration_id"] == first["id"]
    outcomes = [run["outcome"] for run in live.get(f"/v1/schedules/{schedule.id}/runs").json()]
    assert outcomes == ["queued", "no-new-phantom-scan", "queued"]


def ask_for_work(live, scanner_id: str, content: bytes) -> list[dict]:
    """Two scans, each read anew, and a calibration that is computed anew."""
    scans = [live.upload_phantom(content, scanner_id) for _ in range(2)]
    return [*scans, live.post("/v1/calibrations", json={"scan_id": scans[0]["id"]})]


def sum_of_arrays(path: Path) -> str:
    """Of all numbers in an HDF5 file, which also holds the time at which it was written."""
    computed = hashlib.sha256()

    def add(name: str, found: h5py.Dataset | h5py.Group) -> None:
        if isinstance(found, h5py.Dataset) and found.dtype.kind in "fiu":
            computed.update(name.encode() + np.ascontiguousarray(found[()]).tobytes())

    with h5py.File(path) as file:
        file.visititems(add)
    return computed.hexdigest()


def results_of(service, asked: list[dict]) -> dict[str, object]:
    """Once all is done: the sum of line integrals and angles, and what calibrations answer but how long they took."""
    results: dict[str, object] = {}
    for each in asked:
        job = service.wait(each["job_id"])
        assert job["state"] == "succeeded", job
        if job["kind"] == "ingest":
            results[each["id"]] = sum_of_arrays(service.data / "scans" / each["id"] / "scan.h5")
        else:
            result = service.get(f"/v1/calibrations/{each['id']}").json()
            results[each["id"]] = {name: value for name, value in result.items() if name not in {"timing_s", "job"}}
    return results


def test_a_backup_taken_while_jobs_run_does_the_rest_elsewhere(embedded, offline, tmp_path, phantom_scan):
    live = embedded
    scanner_id = live.create_scanner(name="backed up")
    (tmp_path / "disk").mkdir()
    *_, done = ask_for_work(live, scanner_id, phantom_scan())
    assert live.wait(done["job_id"])["state"] == "succeeded"
    settings = StorageSettings(data_folder=live.data)
    states: list[str] = []
    while "running" not in states or "queued" not in states:
        asked = ask_for_work(live, scanner_id, phantom_scan())
        taken = take_backup(settings, tmp_path / "disk", lambda _: None, named=NAMED_FOLDERS)
        with closing(sqlite3.connect(taken.path / "database" / "sawmill.db")) as rows:
            states = [state for (state,) in rows.execute("SELECT state FROM jobs")]
    results = results_of(live, asked)
    assert Backup(taken.path).damage(lambda _: None) == []
    restore(taken.path, StorageSettings(data_folder=tmp_path / "data"), lambda _: None)
    with serving(tmp_path, offline.variables, "--no-examples") as restored:
        assert results_of(restored, asked) == results
        assert {job["losses"] for job in restored.get("/v1/jobs", params={"limit": 200}).json()["items"]} == {0}
    unchanged = list((live.data / "calibrations" / done["id"]).iterdir())
    assert unchanged
    for file in unchanged:
        assert (tmp_path / "data" / file.relative_to(live.data)).read_bytes() == file.read_bytes()


def test_nothing_asked_for_the_network(seeded, offline, tmp_path):
    for path in ("/", "/docs", "/openapi.json", "/v1/phantoms", "/metrics"):
        assert seeded.client.get(path).status_code == 200, path
    asked = "import socket; socket.create_connection(('192.0.2.1', 80))"
    assert offline.asked_for() == ""
    other = Offline(tmp_path)
    done = subprocess.run([sys.executable, "-c", asked], env=other.variables, capture_output=True, check=False)
    assert done.returncode != 0
    assert "192.0.2.1" in other.asked_for(), "the guard must see what it guards against"
