from inspect import iscoroutinefunction

import pytest
from asgi import refusal
from results import SCANNER_SPEC as SPEC

from sawmill_service import dependencies
from sawmill_service.access import check_scope
from sawmill_service.app import create_app
from sawmill_service.http.bodies.forms import check_csrf
from sawmill_service.http.bodies.sent_json import check_body, check_query
from sawmill_service.http.route_rules import check_method
from sawmill_service.settings import ServiceSettings

HERE = "http://127.0.0.1:8000/health/live"
# The address that a client called is where its connection came in; nothing is sent to it here.
CALLED = "http://192.0.2.7:8000/health/live"
ALL = "0.0.0.0"  # noqa: S104 - nothing listens
LOOPBACK = ("127.0.0.1", "127.0.0.1:8000", "localhost:9", "LOCALHOST", "[::1]:8000", "[::1]")
OTHERS = (
    "mill.example",
    "127.0.0.1.evil.example",
    "localhost@evil.example",
    "",
    "evil:127.0.0.1",
    "localhost:80@evil.example",
)


@pytest.mark.parametrize(
    ("variables", "url", "host", "status"),
    [
        *(({}, HERE, host, 200) for host in LOOPBACK),
        *(({}, HERE, host, 421) for host in OTHERS),
        ({"allowed_hosts": ["Scanner.Mill"]}, HERE, "scanner.mill:8000", 200),
        # A loopback name is not answered from elsewhere, its own and allowed ones are.
        *(({"host": ALL}, CALLED, host, 421) for host in ("localhost", "127.0.0.1:8000", "[::1]", "0.0.0.0:8000")),
        ({"host": ALL}, HERE, "127.0.0.1:8000", 200),
        ({"host": ALL, "allowed_hosts": ["localhost"]}, CALLED, "localhost:8000", 200),
        ({"host": "192.0.2.7"}, CALLED, "192.0.2.7:8000", 200),
        ({"host": "scanner.mill"}, CALLED, "Scanner.Mill:8000", 200),
        ({"host": "2001:db8::7"}, CALLED, "[2001:db8::7]:8000", 200),
    ],
)
def test_names_of_the_service_are_answered_and_no_others(client, store, variables, url, host, status):
    client.app = create_app(ServiceSettings(**variables), store, print)
    answer = client.get(url, headers={"Host": host})
    assert answer.status_code == status
    assert status == 200 or answer.json()["code"] == "unknown-host"


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
    assert refusal(client.post("/v1/scanners", json=SPEC, headers=headers)) == (403, "other-site")
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
    assert (headers["X-Content-Type-Options"], headers["Cross-Origin-Resource-Policy"]) == ("nosniff", "same-origin")


def test_a_request_takes_no_thread_before_its_route_does():
    checks = (check_method, check_scope, check_csrf, check_query, check_body)
    given = [alias.__metadata__[0].dependency for name, alias in vars(dependencies).items() if name.startswith("The")]
    assert dependencies.TheStore.__metadata__[0].dependency in given
    # FastAPI runs every other function in a thread, and the request waits for it.
    assert [each for each in (*checks, *given) if not iscoroutinefunction(each)] == []
