from inspect import iscoroutinefunction

import pytest
from results import SCANNER_SPEC as SPEC

from sawmill_service import dependencies
from sawmill_service.access import check_scope
from sawmill_service.app import create_app
from sawmill_service.http.bodies.forms import check_csrf
from sawmill_service.http.bodies.sent_json import check_body, check_query
from sawmill_service.http.route_rules import check_method
from sawmill_service.settings import ServiceSettings


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:8000", "localhost:9", "LOCALHOST", "[::1]:8000", "[::1]"])
def test_loopback_names_are_answered(client, host):
    assert client.get("/health/live", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        "mill.example",
        "127.0.0.1.evil.example",
        "localhost@evil.example",
        "",
        "evil:127.0.0.1",
        "localhost:80@evil.example",
    ],
)
def test_other_names_are_refused(client, host):
    answer = client.get("/health/live", headers={"Host": host})
    assert (answer.status_code, answer.json()["code"]) == (421, "unknown-host")


def test_a_configured_name_is_answered(client, store):
    client.app = create_app(ServiceSettings(allowed_hosts=["Scanner.Mill"]), store, print)
    assert client.get("/health/live", headers={"Host": "scanner.mill:8000"}).status_code == 200


# The address that a client called is where its connection came in; nothing is sent to it here.
CALLED = "http://192.0.2.7:8000/health/live"


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:8000", "[::1]", "0.0.0.0:8000"])
def test_a_loopback_name_is_not_answered_from_elsewhere(client, store, host):
    client.app = create_app(ServiceSettings(host="0.0.0.0"), store, print)  # noqa: S104 - nothing listens
    answer = client.get(CALLED, headers={"Host": host})
    assert (answer.status_code, answer.json()["code"]) == (421, "unknown-host")
    assert client.get("/health/live").status_code == 200


@pytest.mark.parametrize(
    ("settings", "host"),
    [
        (ServiceSettings(host="0.0.0.0", allowed_hosts=["localhost"]), "localhost:8000"),  # noqa: S104
        (ServiceSettings(host="192.0.2.7"), "192.0.2.7:8000"),
        (ServiceSettings(host="scanner.mill"), "Scanner.Mill:8000"),
        (ServiceSettings(host="2001:db8::7"), "[2001:db8::7]:8000"),
    ],
)
def test_its_own_name_and_allowed_ones_are_answered_from_everywhere(client, store, settings, host):
    client.app = create_app(settings, store, print)
    assert client.get(CALLED, headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "https://127.0.0.1:8000"},
        {"Origin": "data://127.0.0.1:8000"},
        {"Origin": "null"},
        {"Origin": "null", "Sec-Fetch-Site": "same-origin"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_another_sites_page_may_read_nothing_into_and_change_nothing(client, headers):
    answer = client.post("/v1/scanners", json=SPEC, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "other-site")
    assert client.get("/v1/scanners").json()["items"] == []
    assert "Access-Control-Allow-Origin" not in client.get("/v1/scanners", headers=headers).headers


@pytest.mark.parametrize("headers", [{}, {"Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"}])
def test_programs_and_our_own_pages_may(client, headers):
    assert client.post("/v1/scanners", json=SPEC, headers=headers).status_code == 201


@pytest.mark.parametrize(("origin", "status"), [("https", 401), ("http", 401), ("data", 403)])
def test_a_page_behind_a_proxy_that_speaks_tls_is_our_own(client, store, origin, status):
    client.app = create_app(ServiceSettings(public_url="https://mill.example"), store, print)
    headers = {"Host": "mill.example", "Origin": f"{origin}://mill.example"}
    assert client.post("/v1/scanners", json=SPEC, headers=headers).status_code == status


@pytest.mark.parametrize(
    "path", ["/v1/keys", "/v1/keys/own", "/v1/audit", "/v1/audit.jsonl", "/v1/jobs", "/v1/nothing"]
)
def test_no_browser_writes_json_to_its_disk(client, path):
    assert "no-store" in client.get(path).headers["Cache-Control"]
    assert client.get("/static/console.js").headers["Cache-Control"] == "no-cache"


@pytest.mark.parametrize("path", ["/", "/docs", "/v1/scanners", "/nothing", "/static/console.js"])
def test_every_answer_is_protected(client, path):
    headers = client.get(path).headers
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_a_request_takes_no_thread_before_its_route_does():
    checks = (check_method, check_scope, check_csrf, check_query, check_body)
    given = [alias.__metadata__[0].dependency for name, alias in vars(dependencies).items() if name.startswith("The")]
    assert dependencies.TheStore.__metadata__[0].dependency in given
    # FastAPI runs every other function in a thread, and the request waits for it.
    assert [each for each in (*checks, *given) if not iscoroutinefunction(each)] == []
