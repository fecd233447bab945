import pytest
from machine_faults import database_away
from starlette.responses import PlainTextResponse
from structlog.contextvars import bound_contextvars, get_contextvars

from sawmill_service.app import create_app
from sawmill_service.http.observer import RequestIds
from sawmill_service.settings import ServiceSettings

TOKEN = "that-of-the-service-0123456789abcdef"  # noqa: S105 - it guards nothing


@pytest.mark.parametrize("path", ["/", "/v1/scanners", "/v1/scanners/none", "/nowhere", "/health/live", "/static/x"])
def test_every_answer_has_an_id_of_its_own(client, path):
    ids = {client.get(path).headers["X-Request-Id"] for _ in range(3)}
    assert len(ids) == 3


def test_the_clients_id_is_kept(client):
    answer = client.get("/v1/scanners/none", headers={"X-Request-Id": "line-2:run_7.a"})
    assert answer.headers["X-Request-Id"] == "line-2:run_7.a"
    assert answer.json()["request_id"] == "line-2:run_7.a"


@pytest.mark.parametrize("given", ["", "a b", "x" * 65, "<script>", "a\tb", "é", '{"a":1}', "-x", "a;b", "a\\nb"])
def test_an_id_that_could_be_more_than_an_id_is_replaced(client, given):
    answer = client.get("/v1/scanners", headers={"X-Request-Id": given.encode("latin-1")})
    assert answer.headers["X-Request-Id"] != given
    assert answer.headers["X-Request-Id"].isalnum()


def test_refusals_before_any_route_have_it_too(client, store):
    client.app = create_app(ServiceSettings(token=TOKEN), store, print)
    for headers in ({}, {"Host": "elsewhere.example"}):
        answer = client.get("/v1/scanners", headers=headers)
        assert answer.status_code in {401, 421}
        assert answer.json()["request_id"] == answer.headers["X-Request-Id"]


def test_an_unexpected_error_is_found_in_the_log_under_the_answers_id(client, store, log_lines):
    store.scanners = None
    answer = client.get("/v1/scanners")
    reference = answer.json()["request_id"]
    assert answer.json()["detail"].endswith(f"its log has more under {reference}")
    (failed,) = [line for line in log_lines() if line["event"] == "request-failed"]
    assert failed["request_id"] == reference == answer.headers["X-Request-Id"]
    assert failed["exception"][0]["exc_type"] == "AttributeError"


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
    assert (happened["event"], happened["what"], happened["request_id"]) == ("event", "queued", "mine")
    assert {**line, "seconds": 0, "timestamp": ""} == {
        "event": "request",
        "level": "info",
        "timestamp": "",
        "request_id": "mine",
        "method": "POST",
        "route": "/v1/calibrations",
        "status": 202,
        "seconds": 0,
        "bytes": len(asked.content),
        "job_id": asked.json()["job_id"],
    }
    job = seeded.get(f"/v1/jobs/{line['job_id']}").json()
    assert (job["request_id"], job["key_id"]) == ("mine", None)
    assert (other["method"], other["route"], other["status"]) == ("other", "unmatched", 404)


def test_what_machines_ask_every_few_seconds_is_no_line_unless_it_fails(client, store, log_lines):
    for path in ("/health/live", "/health/ready", "/metrics"):
        client.get(path)
    assert log_lines() == []
    with database_away(store.database):
        client.get("/health/ready")
    assert [line["event"] for line in log_lines()] == ["not-ready", "request"]
