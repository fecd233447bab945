"""What a request leaves in the log: its id and one line, no secret and no local variable."""

import json
import re

import pytest
from machine_faults import database_away
from sqlalchemy import insert
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session
from starlette.responses import PlainTextResponse
from structlog.contextvars import bound_contextvars, get_contextvars

from sawmill_platform.database.tables import JobRow
from sawmill_service.app import create_app
from sawmill_service.http.observer import RequestIds
from sawmill_service.settings import ServiceSettings

TOKEN = "sesame-of-the-service-0123456789abcdef"  # noqa: S105 - it guards nothing
# Each would be a secret where it stands; none may be in the log.
SECRET = "sesame"  # noqa: S105
HEADERS = {
    "Authorization": f"Bearer {TOKEN}",
    "Cookie": "session=sesame-cookie",
    "X-Api-Key": "sesame-header",
    "X-Request-Id": "sesame with a blank",
    "User-Agent": "sesame-agent",
    "Referer": "http://127.0.0.1:8000/login?key=sesame-referer",
}
REQUESTS = [
    ("GET", "/v1/scanners?token=sesame-query", None),
    ("GET", "/v1/scanners?limit=sesame-query", None),
    ("GET", "/v1/scanners/example?key=sesame-query", None),
    ("GET", "/sesame-path", None),
    ("GET", "/v1/scanners/sesame-path", None),
    ("POST", "/v1/scanners", b'{"name": "sesame-body"'),
    ("POST", "/v1/scanners", b'{"name": "sesame-body", "token": "sesame-body"}'),
    ("POST", "/v1/scanners", b"sesame" * 10_000),
    ("PUT", "/v1/scanners/example", b'{"name": 7, "constants": "sesame-body"}'),
    ("POST", "/v1/jobs/example/cancel", b"sesame-body"),
    ("POST", "/v1/scans?scanner_id=sesame-query", b"sesame-body"),
    ("POST", "/v1/keys", b'{"name": "sesame-name", "scope": "sesame-scope"}'),
    ("BREW-SESAME", "/v1/scanners", None),
]


class Failing:
    """A resource that fails while a local variable holds a secret."""

    def __getattr__(self, _):
        def fail(*_args, **_kwargs):
            local = TOKEN
            raise KeyError(len(local))

        return fail


@pytest.fixture
def guarded(client, store):
    client.app = create_app(ServiceSettings(token=TOKEN, max_json_bytes=20_000), store, print)
    return client


def test_a_new_key_is_in_its_answer_alone(guarded, log_text):
    log, asked = log_text("json"), {"name": "line 2", "scope": "submit"}
    made = guarded.post("/v1/keys", json=asked, headers={"Authorization": f"Bearer {TOKEN}"}).json()
    for secret in (made["secret"], made["secret"][:-1]):
        guarded.get("/v1/scanners", headers={"Authorization": f"Bearer {secret}"})
    *_, right, wrong = [json.loads(line) for line in log.getvalue().splitlines()]
    assert (right["status"], right["key_id"], wrong["status"]) == (200, made["id"], 401)
    assert "key_id" not in wrong
    assert made["secret"][-20:-1] not in log.getvalue()


def test_what_a_database_refuses_is_not_repeated(store):
    without_state = {"id": "sesame", "created_at": store.database.now(), "kind": "plan", "subject_id": "sesame-value"}
    with pytest.raises(IntegrityError) as refused, Session(store.database.engine) as session:
        session.execute(insert(JobRow), [without_state])
    assert SECRET not in str(refused.value)


@pytest.mark.parametrize("broken", [False, True])
def test_no_operation_logs_what_it_was_given(guarded, store, log_text, broken):
    log = log_text("json")
    if broken:
        store.scanners = store.jobs = store.scans = store.calibrations = store.phantoms = store.schedules = Failing()
    paths = guarded.app.openapi()["paths"]
    asked = [(method.upper(), re.sub(r"{\w+}", "sesame", path)) for path, item in paths.items() for method in item]
    for method, path in asked:
        body = None if method == "GET" else b'{"name": "sesame", "scan_id": "sesame", "spec": "sesame"}'
        headers = {**HEADERS, "Content-Type": "application/json"}
        guarded.request(method, f"{path}?after=sesame", content=body, headers=headers)
    assert (
        log.getvalue().count('"event": "request"') >= len(asked) - 3
    )  # health and metrics are none where they succeed
    assert ("exc_type" in log.getvalue()) == broken
    assert SECRET not in log.getvalue()


@pytest.mark.parametrize("log_format", ["json", "console"])
@pytest.mark.parametrize("broken", [False, True])
def test_no_secret_and_no_local_variable_is_logged(guarded, store, log_text, log_format, broken):
    log = log_text(log_format)
    if broken:
        store.scanners = store.jobs = Failing()
    statuses = set()
    for method, path, body in REQUESTS:
        for changed in (
            {},
            {"Authorization": "Bearer sesame-wrong"},
            {"Host": "sesame.example"},
            {"Content-Length": "sesame"},
            {"Origin": "http://sesame.example"},
        ):
            headers = {"Content-Type": "application/json", **HEADERS, **changed}
            statuses.add(guarded.request(method, path, content=body, headers=headers).status_code)
    assert statuses >= {400, 401, 403, 404, 405, 413, 421, 422} | ({500} if broken else set())
    written = log.getvalue()
    assert written.count("request") >= 5 * len(REQUESTS)
    assert ("Traceback" in written or "exc_type" in written) == broken
    assert SECRET not in written.lower()
    if log_format == "json":
        assert all(json.loads(line)["request_id"] for line in written.splitlines())


def test_every_answer_has_an_id_of_its_own_or_the_client_s_where_that_is_no_more_than_an_id(client, store):
    for path in ("/", "/v1/scanners", "/v1/scanners/none", "/nowhere", "/health/live", "/static/x"):
        assert len({client.get(path).headers["X-Request-Id"] for _ in range(3)}) == 3
    answer = client.get("/v1/scanners/none", headers={"X-Request-Id": "line-2:run_7.a"})
    assert answer.headers["X-Request-Id"] == answer.json()["request_id"] == "line-2:run_7.a"
    for given in ("", "a b", "x" * 65, "<script>", "a\tb", "é", '{"a":1}', "-x", "a;b", "a\\nb"):
        replaced = client.get("/v1/scanners", headers={"X-Request-Id": given.encode("latin-1")}).headers["X-Request-Id"]
        assert replaced != given
        assert replaced.isalnum()
    client.app = create_app(ServiceSettings(token=TOKEN), store, print)  # refusals before any route have it, too
    for headers, status in (({}, 401), ({"Host": "elsewhere.example"}, 421)):
        answer = client.get("/v1/scanners", headers=headers)
        assert (answer.status_code, answer.json()["request_id"]) == (status, answer.headers["X-Request-Id"])


def test_what_an_earlier_request_bound_is_not_said_of_the_next(client):
    async def tell(scope, receive, send):
        await PlainTextResponse(str(sorted(get_contextvars())))(scope, receive, send)

    client.app = RequestIds(tell)
    with bound_contextvars(key_id="of another"):
        assert client.get("/").text == "['request_id']"
    assert get_contextvars() == {}


def test_each_request_is_one_line(seeded, log_lines):
    asked = seeded.post("/v1/calibrations", json={"scan_id": "example"}, headers={"X-Request-Id": "mine"})
    seeded.request("BREW", "/nowhere")
    happened, line, other = log_lines()
    assert (happened["event"], happened["type"], happened["request_id"]) == ("event", "queued", "mine")
    expected = {"event": "request", "level": "info", "timestamp": "", "request_id": "mine", "seconds": 0, "status": 202}
    expected |= {"method": "POST", "route": "/v1/calibrations", "bytes": len(asked.content)}
    assert {**line, "seconds": 0, "timestamp": ""} == expected | {"job_id": asked.json()["job_id"]}
    job = seeded.get(f"/v1/jobs/{line['job_id']}").json()
    assert (job["request_id"], job["key_id"]) == ("mine", None)
    assert (other["method"], other["route"], other["status"]) == ("other", "unmatched", 404)


def test_an_unexpected_error_is_in_the_log_under_its_id_and_what_machines_ask_only_where_it_fails(
    client, store, log_lines
):
    for path in ("/health/live", "/health/ready", "/metrics"):
        client.get(path)
    assert log_lines() == []
    with database_away(store.database):
        client.get("/health/ready")
    assert [line["event"] for line in log_lines()] == ["not-ready", "request"]
    store.scanners = None
    answer = client.get("/v1/scanners")
    reference = answer.json()["request_id"]
    assert answer.json()["detail"].endswith(f"its log has more under {reference}")
    (failed,) = [line for line in log_lines() if line["event"] == "request-failed"]
    assert failed["request_id"] == reference == answer.headers["X-Request-Id"]
    assert failed["exception"][0]["exc_type"] == "AttributeError"
