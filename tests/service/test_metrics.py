"""What a scrape tells, and whether the service says that it is ready."""

import threading
import time
from datetime import timedelta

import pytest
import results
from machine_faults import database_away
from prometheus_client.parser import text_string_to_metric_families

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.drifts import DriftAsk
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_service.app import create_app
from sawmill_service.measures import Measures
from sawmill_store.store import Store

pytestmark = pytest.mark.usefixtures("seeded")


@pytest.fixture
def scrape(client):
    """Reads one value by its name and labels; none where there is none."""

    def read(name: str, **labels: str) -> float | None:
        families = text_string_to_metric_families(client.get("/metrics").text)
        found = (sample for family in families for sample in family.samples)
        return next((sample.value for sample in found if (sample.name, sample.labels) == (name, labels)), None)

    return read


def fail(store, code: str, kind: FailureKind = FailureKind.INPUT) -> None:
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=kind, code=code, detail="it failed"))


def test_a_scrape_of_the_examples(scrape):
    assert scrape("sawmill_jobs_by_kind", kind="ingest", state="queued") == 0
    assert scrape("sawmill_attempts_total", kind="reconstruct", outcome="lost") == 0
    assert scrape("sawmill_job_failures_total", kind="drift", fault="internal", code="internal-error") == 0
    assert scrape("sawmill_job_duration_seconds_count", kind="trace-phantom") == 0
    assert scrape("sawmill_attempts_total", kind="ingest", outcome="succeeded") == 2
    assert scrape("sawmill_job_duration_seconds_bucket", kind="ingest", le="+Inf") == 2
    assert scrape("sawmill_job_duration_seconds_sum", kind="ingest") < 60
    of_scanner = {"scanner": "example"}
    assert scrape("sawmill_scanner_in_tolerance", **of_scanner) == 1
    assert scrape("sawmill_scanner_calibration_failed", **of_scanner) == 0
    for which in ("active", "newest"):
        assert scrape("sawmill_scanner_ray_error_millimeters", **of_scanner, calibration=which) == 0.02
        assert scrape("sawmill_scanner_ray_error_upper_95_millimeters", **of_scanner, calibration=which) == 0.04
    assert scrape("sawmill_scanner_ray_error_tolerance_millimeters", **of_scanner) == 0.1
    assert scrape("sawmill_scanner_movement_millimeters", **of_scanner, seen_by="drift") == 0.01
    assert scrape("sawmill_scanner_movement_tolerance_millimeters", **of_scanner) == 0.5
    assert 0 <= scrape("sawmill_scanner_calibration_age_seconds", **of_scanner) < 3600
    assert 0 <= scrape("sawmill_scanner_drift_check_age_seconds", **of_scanner) < 3600
    assert scrape("sawmill_scanner_in_tolerance", scanner="example-spare") is None
    assert scrape("sawmill_scanner_calibration_failed", scanner="example-spare") == 0


def test_the_old_count_has_its_old_labels_and_the_new_one_adds_up_to_it(seeded, scrape):
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    assert scrape("sawmill_jobs", state="queued") == 1
    assert scrape("sawmill_jobs_by_kind", kind="calibrate", state="queued") == 1
    assert scrape("sawmill_oldest_queued_job_seconds", kind="calibrate") >= 0.0


def test_failures_are_counted_by_code_and_unknown_codes_as_one(seeded, store, scrape):
    for code in ("too-few-views", "<made up>", "of an older version"):
        seeded.post("/v1/calibrations", json={"scan_id": "example"})
        fail(store, code)
    assert scrape("sawmill_job_failures_total", kind="calibrate", fault="input", code="too-few-views") == 1
    assert scrape("sawmill_job_failures_total", kind="calibrate", fault="input", code="other") == 2


def test_memory_of_attempts(seeded, store, scrape):
    for peak_memory_bytes in (2**30, 2**31):
        seeded.post("/v1/drifts", json={"scan_id": "example"})
        claim = store.jobs.claim("test")
        output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
        answer = results.answer_of(claim.job.kind, results.drift_result())
        store.jobs.succeed(claim, answer, output, peak_memory_bytes=peak_memory_bytes)
    assert scrape("sawmill_attempt_peak_memory_bytes_sum", kind="drift") == 3 * 2**30
    assert scrape("sawmill_attempt_peak_memory_bytes_count", kind="drift") == 2
    assert scrape("sawmill_attempt_peak_memory_max_bytes", kind="drift") == 2**31


def test_a_log_that_shows_movement_turns_the_scanner_red(store, worker, scrape):
    store.drifts.accept(DriftAsk(scan_id="example"))
    worker.finish_drift(within_tolerance=False, ray_change_mm=0.7, reason="the detector moved")
    assert scrape("sawmill_scanner_in_tolerance", scanner="example") == 0
    assert scrape("sawmill_scanner_movement_millimeters", scanner="example", seen_by="drift") == 0.7


@pytest.mark.parametrize("by", ["failing", "failing its check"])
def test_a_calibration_that_failed(store, worker, scrape, by):
    store.calibrations.accept(CalibrationAsk(scan_id="example"))
    if by == "failing":
        fail(store, "phantom-not-seen")
    else:
        worker.finish_calibration(verdict="fail", predicted_ray_error_mm=None)
    assert scrape("sawmill_scanner_calibration_failed", scanner="example") == 1
    assert scrape("sawmill_scanner_ray_error_millimeters", scanner="example", calibration="active") == 0.02


def test_jobs_that_wait_for_a_worker(seeded, store, settings, scrape):
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    assert scrape("sawmill_jobs_without_worker") == 0
    later = Store(store.settings, clock=lambda: store.now() + timedelta(minutes=1))
    seeded.app = create_app(settings, later, print)
    assert scrape("sawmill_jobs_without_worker") == 1
    store.jobs.claim("test")
    assert scrape("sawmill_jobs_without_worker") == 0
    later.close()


def test_a_database_that_is_away_leaves_the_rest(store, scrape):
    assert scrape("sawmill_database_up") == 1
    with database_away(store.database):
        assert (scrape("sawmill_database_up"), scrape("sawmill_jobs", state="queued")) == (0, None)
        assert scrape("sawmill_data_folder_free_bytes") > 0
        assert scrape("sawmill_http_requests_total", method="GET", route="/metrics", status="200") >= 3


def test_a_data_folder_that_is_away_leaves_the_rest(store, scrape):
    (store.files.folder / "identity").unlink()  # as in the empty folder of a share that is not mounted
    assert (scrape("sawmill_data_folder_up"), scrape("sawmill_data_folder_free_bytes")) == (0, None)
    assert scrape("sawmill_database_up") == 1


def test_scrapes_at_once_share_a_count_that_begins_after_they_came(store):
    """Of many that wait for the first, one counts for all."""
    begun, go_on, came = threading.Event(), threading.Event(), threading.Semaphore(0)
    counts = []

    def clock_s() -> float:
        """Tell that somebody has come, whose time this is."""
        try:
            return time.monotonic()
        finally:
            came.release()

    measures, tallies = Measures(store, clock_s=clock_s), store.tallies

    class Slow:
        def read(self):
            counts.append(len(counts))
            begun.set()
            assert go_on.wait(60)
            return tallies.read()

    store.tallies = Slow()
    threads = [threading.Thread(target=measures.collect) for _ in range(5)]
    threads[0].start()
    assert begun.wait(60)
    assert came.acquire(timeout=60), "the first came"
    assert came.acquire(timeout=60), "and began to count"
    for thread in threads[1:]:
        thread.start()
    for _ in threads[1:]:
        assert came.acquire(timeout=60)
    go_on.set()
    for thread in threads:
        thread.join(60)
    assert len(counts) == 2


def test_requests_are_counted_by_route_and_known_methods(client, scrape):
    for identifier in ("one", "two"):
        client.get(f"/v1/scanners/{identifier}")
    client.get("/no/such/path")
    for method in ("BREW", "WHEN"):
        client.request(method, "/v1/scanners")
    route, total = "/v1/scanners/{scanner_id}", "sawmill_http_requests_total"
    assert scrape(total, method="GET", route=route, status="404") == 2
    assert scrape(total, method="GET", route="unmatched", status="404") == 1
    assert scrape("sawmill_http_request_seconds_count", method="GET", route=route) == 2
    assert scrape(total, method="other", route="/v1/scanners", status="405") == 2
    assert "BREW" not in client.get("/metrics").text


def test_a_service_with_nothing_to_do_is_ready(client):
    assert client.get("/health/live").text == "alive"
    assert client.get("/health/ready").json() == {"state": "ready", "detail": ""}


def test_a_database_that_is_away_is_reported(client, store, log_lines):
    with database_away(store.database):
        answer = client.get("/health/ready")
        assert (answer.status_code, answer.json()["code"]) == (503, "storage-unavailable")
        assert client.get("/health/live").status_code == 200
    assert "disk I/O error" not in answer.text, "anybody may ask"
    [line] = [line for line in log_lines() if line["event"] == "not-ready"]
    assert line["reason"].endswith("disk I/O error")


@pytest.mark.usefixtures("read_only_disk")
def test_a_data_folder_on_a_read_only_disk_is_named(seeded):
    ready = seeded.get("/health/ready")
    assert (ready.status_code, ready.json()["code"], ready.headers["retry-after"]) == (503, "storage-unavailable", "5")
    assert "is on a disk that is read-only now" in ready.json()["detail"]


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("not mounted", "has no file 'identity'"),
        ("another one", "is another one"),
        ("without its folders", "/data/incoming"),
    ],
)
def test_a_data_folder_that_cannot_be_used_is_named_and_uploads_are_put_off(seeded, store, trouble, words):
    identity = store.files.folder / "identity"
    if trouble == "not mounted":
        identity.unlink()
    elif trouble == "without its folders":
        (store.files.folder / "incoming").rmdir()
    else:
        identity.write_text("of another service\n")
    ready = seeded.get("/health/ready")
    assert (ready.status_code, ready.json()["code"], ready.headers["retry-after"]) == (503, "storage-unavailable", "5")
    assert words in ready.json()["detail"]
    sent = seeded.post("/v1/scans?scanner_id=example&data=counts", content=b"scan")
    assert (sent.status_code, sent.json()["code"]) == (503, "storage-unavailable")
    assert words in sent.json()["detail"]
    assert seeded.get("/v1/scans").status_code == 200


@pytest.mark.parametrize(("running", "state"), [(0, "without-worker"), (1, "ready")])
def test_jobs_that_nobody_does_are_reported(client, store, running, state):
    store.jobs = Waiting(running)
    answer = client.get("/health/ready")
    assert (answer.status_code, answer.json()["state"]) == (200, state)


def test_jobs_that_wait_for_a_redis_that_refuses_the_password_are_reported(client, store, refusing_redis_url):
    client.app.state.broker_url = refusing_redis_url
    assert "refuses the user or the password: jobs do not begin" in client.get("/system").text
    store.jobs = Waiting(running=0)
    health = client.get("/health/ready").json()
    assert health["state"] == "without-worker"
    assert health["detail"].endswith("Redis refuses the user or the password in SAWMILL_BROKER_URL")


class Waiting:
    """Jobs of which two have waited for long."""

    def __init__(self, running: int) -> None:
        self.running = running

    def queued_job_ids(self, *, older_than_s: float, limit: int) -> list[str]:
        assert older_than_s > 0
        return ["a", "b"][:limit]

    def counts(self) -> dict[JobState, int]:
        return dict.fromkeys(JobState, 0) | {JobState.RUNNING: self.running}
