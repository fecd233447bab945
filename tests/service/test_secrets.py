"""No secret and no local variable is in the log, whatever becomes of a request."""

import json
import re

import pytest
from sqlalchemy import insert
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from sawmill_platform.database.tables import JobRow
from sawmill_service.app import create_app
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
    log = log_text("json")
    asked = {"name": "line 2", "scope": "submit"}
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
