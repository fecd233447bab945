"""What a scrape tells, whether the service says that it is ready, and that the example rules name what a scrape has."""

import json
import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import NamedTuple

import httpx
import pytest
import results
import yaml
from asgi import refusal
from live_service import process, serving, wait_until
from machine_faults import database_away
from missing_parts import free_port, skip_without
from prometheus_client.parser import text_string_to_metric_families

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_contracts.drifts import DriftRequest
from sawmill_platform.contracts.jobs import Failure, FailureKind, JobState
from sawmill_service.app import create_app
from sawmill_service.measures import Measures
from sawmill_store.store import Store

pytestmark = pytest.mark.usefixtures("seeded")


def scrape(client, name: str, **labels: str) -> float | None:
    families = text_string_to_metric_families(client.get("/metrics").text)
    found = (sample for family in families for sample in family.samples)
    return next((sample.value for sample in found if (sample.name, sample.labels) == (name, labels)), None)


def fail(store, code: str, kind: FailureKind = FailureKind.INPUT) -> None:
    store.jobs.fail(store.jobs.claim("test"), Failure(kind=kind, code=code, detail="it failed"))


def test_a_scrape_of_the_examples_and_of_a_job_that_waits_for_a_worker(client, seeded, store, settings):
    assert scrape(client, "sawmill_jobs_by_kind", kind="ingest", state="queued") == 0
    assert scrape(client, "sawmill_attempts_total", kind="reconstruct", outcome="lost") == 0
    assert scrape(client, "sawmill_job_failures_total", kind="drift", fault="internal", code="internal-error") == 0
    assert scrape(client, "sawmill_job_duration_seconds_count", kind="trace-phantom") == 0
    assert scrape(client, "sawmill_attempts_total", kind="ingest", outcome="succeeded") == 2
    assert scrape(client, "sawmill_job_duration_seconds_bucket", kind="ingest", le="+Inf") == 2
    assert scrape(client, "sawmill_job_duration_seconds_sum", kind="ingest") < 60
    of_scanner = {"scanner": "example"}
    assert scrape(client, "sawmill_scanner_in_tolerance", **of_scanner) == 1
    assert scrape(client, "sawmill_scanner_calibration_failed", **of_scanner) == 0
    for which in ("active", "newest"):
        assert scrape(client, "sawmill_scanner_ray_error_millimeters", **of_scanner, calibration=which) == 0.02
        assert scrape(client, "sawmill_scanner_ray_error_upper_95_millimeters", **of_scanner, calibration=which) == 0.04
    assert scrape(client, "sawmill_scanner_ray_error_tolerance_millimeters", **of_scanner) == 0.1
    assert scrape(client, "sawmill_scanner_movement_millimeters", **of_scanner, seen_by="drift") == 0.01
    assert scrape(client, "sawmill_scanner_movement_tolerance_millimeters", **of_scanner) == 0.5
    assert 0 <= scrape(client, "sawmill_scanner_calibration_age_seconds", **of_scanner) < 3600
    assert 0 <= scrape(client, "sawmill_scanner_drift_check_age_seconds", **of_scanner) < 3600
    assert scrape(client, "sawmill_scanner_in_tolerance", scanner="example-spare") is None
    assert scrape(client, "sawmill_scanner_calibration_failed", scanner="example-spare") == 0
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    assert scrape(client, "sawmill_jobs_without_worker") == 0
    later = Store(store.settings, clock=lambda: store.now() + timedelta(minutes=1))
    seeded.app = create_app(settings, later, print)
    assert scrape(client, "sawmill_jobs_without_worker") == 1
    store.jobs.claim("test")
    assert scrape(client, "sawmill_jobs_without_worker") == 0
    later.close()


def test_failures_are_counted_by_code_and_the_new_count_adds_up_to_the_old_one(seeded, store, client):
    for code in ("too-few-views", "<made up>", "of an older version"):
        seeded.post("/v1/calibrations", json={"scan_id": "example"})
        fail(store, code)
    assert scrape(client, "sawmill_job_failures_total", kind="calibrate", fault="input", code="too-few-views") == 1
    assert scrape(client, "sawmill_job_failures_total", kind="calibrate", fault="input", code="other") == 2
    for peak_memory_bytes in (2**30, 2**31):
        seeded.post("/v1/drifts", json={"scan_id": "example"})
        results.succeed(store, peak_memory_bytes=peak_memory_bytes)
    assert scrape(client, "sawmill_attempt_peak_memory_bytes_sum", kind="drift") == 3 * 2**30
    assert scrape(client, "sawmill_attempt_peak_memory_bytes_count", kind="drift") == 2
    assert scrape(client, "sawmill_attempt_peak_memory_max_bytes", kind="drift") == 2**31
    seeded.post("/v1/calibrations", json={"scan_id": "example"})
    assert scrape(client, "sawmill_jobs", state="queued") == 1
    assert scrape(client, "sawmill_jobs_by_kind", kind="calibrate", state="queued") == 1
    assert scrape(client, "sawmill_oldest_queued_job_seconds", kind="calibrate") >= 0.0


def test_movement_and_a_calibration_that_failed_turn_the_scanner_red(store, worker, client):
    store.drifts.accept(DriftRequest(scan_id="example"))
    worker.finish_drift(within_tolerance=False, ray_change_mm=0.7, reason="the detector moved")
    assert scrape(client, "sawmill_scanner_in_tolerance", scanner="example") == 0
    assert scrape(client, "sawmill_scanner_movement_millimeters", scanner="example", seen_by="drift") == 0.7
    unseen, wrong = partial(fail, store, "phantom-not-seen"), {"verdict": "fail", "predicted_ray_error_mm": None}
    good, bad = worker.finish_calibration, partial(worker.finish_calibration, **wrong)
    for end, failed in ((unseen, 1), (good, 0), (bad, 1)):
        store.calibrations.accept(CalibrationRequest(scan_id="example"))
        end()
        assert scrape(client, "sawmill_scanner_calibration_failed", scanner="example") == failed
        assert scrape(client, "sawmill_scanner_ray_error_millimeters", scanner="example", calibration="active") == 0.02


def test_a_database_or_a_data_folder_that_is_away_leaves_the_rest(store, client):
    assert scrape(client, "sawmill_database_up") == 1
    with database_away(store.database):
        assert (scrape(client, "sawmill_database_up"), scrape(client, "sawmill_jobs", state="queued")) == (0, None)
        assert scrape(client, "sawmill_data_folder_free_bytes") > 0
        assert scrape(client, "sawmill_http_requests_total", method="GET", route="/metrics", status="200") >= 3
    (store.files.folder / "identity").unlink()  # as in the empty folder of a share that is not mounted
    assert (scrape(client, "sawmill_data_folder_up"), scrape(client, "sawmill_data_folder_free_bytes")) == (0, None)
    assert scrape(client, "sawmill_database_up") == 1


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


def test_requests_are_counted_by_route_and_known_methods(client):
    for identifier in ("one", "two"):
        client.get(f"/v1/scanners/{identifier}")
    client.get("/no/such/path")
    for method in ("BREW", "WHEN"):
        client.request(method, "/v1/scanners")
    route, total = "/v1/scanners/{scanner_id}", "sawmill_http_requests_total"
    assert scrape(client, total, method="GET", route=route, status="404") == 2
    assert scrape(client, total, method="GET", route="unmatched", status="404") == 1
    assert scrape(client, "sawmill_http_request_seconds_count", method="GET", route=route) == 2
    assert scrape(client, total, method="other", route="/v1/scanners", status="405") == 2
    assert "BREW" not in client.get("/metrics").text


def test_a_service_with_nothing_to_do_is_ready_until_its_database_is_away(client, store, log_lines):
    assert client.get("/health/live").text == "alive"
    assert client.get("/health/ready").json() == {"state": "ready", "detail": ""}
    with database_away(store.database):
        answer = client.get("/health/ready")
        assert (refusal(answer), client.get("/health/live").status_code) == ((503, "storage-unavailable"), 200)
    assert "disk I/O error" not in answer.text, "anybody may ask"
    [line] = [line for line in log_lines() if line["event"] == "not-ready"]
    assert line["reason"].endswith("disk I/O error")


@pytest.mark.usefixtures("read_only_disk")
def test_a_data_folder_on_a_read_only_disk_is_named(seeded):
    ready = seeded.get("/health/ready")
    assert (*refusal(ready), ready.headers["retry-after"]) == (503, "storage-unavailable", "5")
    assert "is on a disk that is read-only now" in ready.json()["detail"]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: (folder / "identity").unlink(), "has no file 'identity'"),
        (lambda folder: (folder / "identity").write_text("of another service\n"), "is another one"),
        (lambda folder: (folder / "incoming").rmdir(), "/data/incoming"),
    ],
    ids=["not mounted", "another one", "without its folders"],
)
def test_a_data_folder_that_cannot_be_used_is_named_and_uploads_are_put_off(seeded, store, spoil, words):
    spoil(store.files.folder)
    ready = seeded.get("/health/ready")
    assert (*refusal(ready), ready.headers["retry-after"]) == (503, "storage-unavailable", "5")
    assert words in ready.json()["detail"]
    sent = seeded.post("/v1/scans?scanner_id=example&data=counts", content=b"scan")
    assert refusal(sent) == (503, "storage-unavailable")
    assert words in sent.json()["detail"]
    assert seeded.get("/v1/scans").status_code == 200


def test_jobs_that_nobody_does_or_that_wait_for_a_redis_that_refuses_are_reported(client, store, refusing_redis_url):
    state, client.app.state.broker_url = client.app.state, refusing_redis_url
    assert "refuses the user or the password: jobs do not begin" in client.get("/system").text
    store.jobs = Waiting(running=0)
    health = client.get("/health/ready").json()
    assert health["state"] == "without-worker"
    assert health["detail"].endswith("Redis refuses the user or the password in SAWMILL_BROKER_URL")
    state.broker_url = None
    for running, word in ((0, "without-worker"), (1, "ready")):
        store.jobs = Waiting(running)
        answer = client.get("/health/ready")
        assert (answer.status_code, answer.json()["state"]) == (200, word)


class Waiting:
    """Jobs of which two have waited for long."""

    def __init__(self, running: int) -> None:
        self.running = running

    def queued_job_ids(self, *, older_than_s: float, limit: int) -> list[str]:
        assert older_than_s > 0
        return ["a", "b"][:limit]

    def counts(self) -> dict[JobState, int]:
        return dict.fromkeys(JobState, 0) | {JobState.RUNNING: self.running}


FOLDER = Path(__file__).parents[2] / "examples" / "monitoring"
# Prometheus's own metric, and what its server adds to each sample.
FROM_ELSEWHERE = {"up": {"job": {"sawmill"}}}
TOKEN = re.compile(r'"[^"]*"|[A-Za-z_:][A-Za-z0-9_:]*|=~|!~|!=|==|[<>]=?|[0-9.]+[smhd]?|[^\s\w]')
# Words of PromQL that take a list of labels, and others that are no metric.
WITH_LABELS = {"by", "on", "without", "ignoring", "group_left", "group_right"}
OTHER_WORDS = {"or", "and", "unless", "sum", "max", "increase", "rate", "absent", "histogram_quantile"}


class Selector(NamedTuple):
    name: str
    matchers: list[tuple[str, str, str]]


def rules() -> list[dict]:
    return [rule for group in yaml.safe_load((FOLDER / "alerts.yml").read_text())["groups"] for rule in group["rules"]]


def dashboard() -> dict:
    return json.loads((FOLDER / "dashboard.json").read_text())


def expressions() -> list[str]:
    targets = [target for panel in dashboard()["panels"] for target in panel.get("targets", [])]
    return [rule["expr"] for rule in rules()] + [target["expr"] for target in targets]


def parsed(expression: str) -> tuple[list[Selector], set[str]]:
    """The selectors of an expression, and the labels that it groups or joins by."""
    words = iter(TOKEN.findall(expression))
    selectors, grouped = [], set()
    for word in words:
        if word in WITH_LABELS:
            assert next(words) == "("
            grouped |= set(up_to(words, ")"))
        elif word == "{":
            asked = up_to(words, "}")
            selectors[-1].matchers.extend(
                zip(asked[::3], asked[1::3], (v.strip('"') for v in asked[2::3]), strict=True)
            )
        elif re.fullmatch(r"[a-z_:]\w*", word) and word not in OTHER_WORDS:
            selectors.append(Selector(word, []))
    return selectors, grouped


def up_to(words: Iterator[str], end: str) -> list[str]:
    return [word for word in iter(words.__next__, end) if word != ","]


def test_rules_and_dashboard_are_whole_and_name_what_is_of_a_scrape(client):
    client.get("/v1/scanners")
    found = defaultdict(lambda: defaultdict(set))  # the values of each label of each name
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            values = found[sample.name]
            for label, value in sample.labels.items():
                values[label].add(value)
    known = FROM_ELSEWHERE | found
    page = dashboard()
    panels = [panel for panel in page["panels"] if panel["type"] != "row"]
    assert page["title"] == "Sawmill calibration"
    assert page["schemaVersion"] >= 36
    assert len({panel["id"] for panel in page["panels"]}) == len(page["panels"])
    assert all(panel["targets"] and panel["datasource"]["uid"] == "${datasource}" for panel in panels)
    places = [panel["gridPos"] for panel in page["panels"]]
    assert all(at["x"] + at["w"] <= 24 for at in places)
    cells = [(at["x"] + x, at["y"] + y) for at in places for x in range(at["w"]) for y in range(at["h"])]
    assert len(cells) == len(set(cells)), "panels lie over each other"
    variables = {variable["name"] for variable in page["templating"]["list"]}
    assert set(re.findall(r"\$\{?([a-z]+)", json.dumps(panels))) <= variables
    assert len({rule["alert"] for rule in rules()}) == len(rules())
    for rule in rules():
        assert rule["labels"]["severity"] in {"warning", "critical"}
        assert {"summary", "description"} == set(rule["annotations"])
        selectors, grouped = parsed(rule["expr"])
        left = grouped if "sum by" in rule["expr"] else {label for name, _ in selectors for label in known[name]}
        assert set(re.findall(r"\$labels\.(\w+)", str(rule["annotations"]))) <= left
    for expression in expressions():
        selectors, grouped = parsed(expression)
        assert selectors, expression
        for name, matchers in selectors:
            assert name in known, expression
            for label, _, value in matchers:
                assert label in known[name], expression
                if label != "status" and not value.startswith("$"):  # no request has failed here
                    assert set(value.split("|")) <= known[name][label], expression
        assert grouped <= {label for name, _ in selectors for label in known[name]}, expression
    for panel in dashboard()["panels"]:
        for target in panel.get("targets", []):
            selectors, grouped = parsed(target["expr"])
            left = grouped or {label for name, _ in selectors for label in known[name]}
            assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= left


@pytest.mark.nightly
def test_prometheus_evaluates_every_rule_on_a_service_and_notices_its_end(tmp_path):
    program = shutil.which("prometheus") or skip_without("prometheus is not installed")
    environment, address, file = dict(os.environ), f"127.0.0.1:{free_port()}", tmp_path / "prometheus.yml"
    options = {"config.file": file, "web.listen-address": address, "storage.tsdb.path": tmp_path / "db"}
    command = [program, *(f"--{name}={value}" for name, value in options.items())]
    client = httpx.Client(base_url=f"http://{address}", trust_env=False, transport=httpx.HTTPTransport(retries=9))

    def rules(what: str) -> dict[str, str]:
        groups = client.get("/api/v1/rules").json()["data"]["groups"]
        return {rule["name"]: rule[what] for group in groups for rule in group["rules"]}

    with client, serving(tmp_path, environment, "--workers", "0", "--no-examples") as service:
        scraped = [{"job_name": "sawmill", "static_configs": [{"targets": [service.client.base_url.netloc.decode()]}]}]
        settings = {"global": {"scrape_interval": "1s", "evaluation_interval": "1s"}, "scrape_configs": scraped}
        file.write_text(json.dumps(settings | {"rule_files": [str(FOLDER / "alerts.yml")]}))
        with process(command, environment, tmp_path / "prometheus.log"):
            wait_until(lambda: client.get("/-/ready").is_success)
            wait_until(lambda: {*rules("health").values()} == {"ok"} and rules("state")["SawmillDown"] == "inactive")
            scrape, lint = service.get("/metrics").text, ["promtool", "check", "metrics"]
            found = subprocess.run(lint, input=scrape, capture_output=True, text=True, check=False)
            # Its one complaint is about style: lengths are in millimetres, as everywhere in the product.
            assert [line for line in found.stderr.splitlines() if 'use base unit "meters"' not in line] == []
            os.kill(service.process_id, signal.SIGTERM)
            wait_until(lambda: rules("state")["SawmillDown"] != "inactive")
