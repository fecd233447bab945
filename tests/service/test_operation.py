import pytest
from machine_faults import database_away
from prometheus_client.parser import text_string_to_metric_families

from sawmill_platform.contracts.jobs import JobState


def samples(client) -> dict[tuple[str, ...], float]:
    text = client.get("/metrics").text
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_requests_are_counted_by_route_and_known_methods(client):
    for identifier in ("one", "two"):
        client.get(f"/v1/scanners/{identifier}")
    client.get("/no/such/path")
    counted = samples(client)
    assert counted["sawmill_http_requests_total", "GET", "/v1/scanners/{scanner_id}", "404"] == 2
    assert counted["sawmill_http_requests_total", "GET", "unmatched", "404"] == 1
    assert counted["sawmill_http_request_seconds_count", "GET", "/v1/scanners/{scanner_id}"] == 2
    for method in ("GET", "BREW", "WHEN"):
        client.request(method, "/v1/scanners")
    counted = samples(client).items()
    methods = [labels[0] for (name, *labels), value in counted if name == "sawmill_http_requests_total" and value]
    assert set(methods) == {"GET", "other"}


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
