"""The token and keys: what needs one, what each scope may do, and that a secret is shown once or never."""

import re
from base64 import b64encode

import pytest
from asgi import refusal
from machine_faults import database_away
from pydantic import ValidationError
from write_lock import write_lock

from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.database.tables import JobRow
from sawmill_service.app import create_app
from sawmill_service.http.route_rules import NoKey, Router, RouteRules
from sawmill_service.settings import ServiceSettings

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
BEHIND = ServiceSettings(public_url="https://calibration.mill.example", trusted_proxies=["127.0.0.1"])


@pytest.fixture
def keyed(seeded, store):
    """A client of a service behind a proxy."""
    seeded.app = create_app(BEHIND, store, print)
    return seeded


def rules(app):
    """The rule of each method and pattern of paths."""
    by_pattern = app.state.rules.by_pattern
    return {(method, path): rule for path, methods in by_pattern.items() for method, rule in methods.items()}


def operations(app):
    return [
        (method.upper(), path) for path, item in app.openapi()["paths"].items() for method in item if path != "/metrics"
    ]


@pytest.mark.parametrize("scope", list(Scope))
def test_a_key_may_do_what_its_scope_covers_and_nothing_else(keyed, scope):
    keyed.bring(scope)
    for method, path in operations(keyed.app):
        if path.endswith("/events"):
            continue  # a stream that does not end here
        where = path.replace("{", "").replace("}", "").replace("_id", "")
        answer = keyed.request(method, where, json={} if method in {"POST", "PUT"} else None)
        refused = answer.status_code == 403
        needed = rules(keyed.app)[method, path].scope
        assert refused is not scope.covers(needed), (method, path, answer.text)
        if refused:
            assert answer.json()["code"] == "scope-too-small"
            assert f"of the scope {needed}" in answer.json()["detail"]


def test_what_decides_or_removes_needs_more_than_work(keyed):
    needs = {operation: rule.scope for operation, rule in rules(keyed.app).items()}
    assert {operation for operation, scope in needs.items() if scope is Scope.ACTIVATE} == {
        ("POST", "/v1/scanners"),
        ("PUT", "/v1/scanners/{scanner_id}"),
        ("POST", "/v1/schedules"),
        ("PUT", "/v1/schedules/{schedule_id}"),
        ("DELETE", "/v1/schedules/{schedule_id}"),
        ("POST", "/v1/calibrations/{calibration_id}/activate"),
        ("POST", "/v1/calibrations/{calibration_id}/discard"),
        ("POST", "/v1/scanners/{scanner_id}/alarms/{what}/acknowledge"),
        ("POST", "/operator/activate/{calibration_id}"),
        ("POST", "/operator/discard/{calibration_id}"),
        ("POST", "/operator/acknowledge/{scanner_id}/{what}"),
        ("POST", "/scanners/new"),
        ("POST", "/scanners/{scanner_id}/settings"),
        ("POST", "/scanners/{scanner_id}/schedules"),
        ("POST", "/scanners/{scanner_id}/schedules/{schedule_id}/delete"),
    }
    administration = {path for (_, path), scope in needs.items() if scope is Scope.ADMIN}
    assert administration >= {"/v1/keys", "/v1/keys/{key_id}", "/v1/keys/{key_id}/rotate", "/v1/scans/{scan_id}"}
    assert {scope for (method, _), scope in needs.items() if method == "GET"} == {Scope.READ, Scope.ADMIN}
    changing = {operation for operation, scope in needs.items() if operation[0] != "GET" and scope is Scope.READ}
    assert changing == {("POST", "/login"), ("POST", "/logout")}
    assert all(needs["POST", kind.asked_at or f"/v1/{kind.kind.plural}"] is Scope.SUBMIT for kind in asked_kinds())


def test_no_route_but_health_the_login_and_the_problems_goes_without_a_key(keyed):
    without = {path: rule.needs for (_, path), rule in rules(keyed.app).items() if isinstance(rule.needs, NoKey)}
    assert without == {
        "/health/live": NoKey.MONITORING,
        "/health/ready": NoKey.MONITORING,
        "/login": NoKey.LOGIN,
        "/login/{link}": NoKey.LOGIN,
        "/look": NoKey.LOGIN,
        "/problems": NoKey.AFTER_REFUSAL,
        "/problems/": NoKey.AFTER_REFUSAL,
        "/problems/{code}": NoKey.AFTER_REFUSAL,
    }


@pytest.mark.parametrize(("method", "reading"), [("GET", None), ("POST", None), ("POST", Scope.READ)])
def test_an_application_with_a_route_without_a_scope_does_not_start(keyed, method, reading):
    router = Router(reading=reading)
    getattr(router, method.lower())("/v1/forgotten")(lambda: None)
    assert isinstance(keyed.app.state.rules, RouteRules), "made at the start"
    with pytest.raises(ValueError, match=f"{method} /v1/forgotten declares no scope"):
        RouteRules([*keyed.app.routes, *router.routes])


def test_activation_on_pass_cannot_be_asked_for_by_who_may_not_activate(keyed):
    keyed.bring(Scope.SUBMIT)
    ask = {"scan_id": "example", "activate": True}
    assert keyed.post("/v1/calibrations", json=ask).json()["code"] == "scope-too-small"
    assert keyed.post("/v1/calibrations", json=ask | {"activate": False}).status_code == 202
    keyed.bring(Scope.ACTIVATE)
    assert keyed.post("/v1/calibrations", json=ask).status_code == 202


def test_a_key_is_made_used_rotated_and_revoked(keyed, store):
    administrator = keyed.bring(Scope.ADMIN)
    made = keyed.post("/v1/keys", json={"name": "scanner of line 2", "scope": "submit"})
    assert (made.status_code, made.headers["Cache-Control"]) == (201, "no-store")
    assert made.json()["created_by"] == administrator.name
    key, secret = made.json()["id"], made.json()["secret"]
    bearer = {"Authorization": f"Bearer {secret}"}
    own = keyed.get("/v1/keys/own", headers=bearer).json()
    assert own == {"name": "scanner of line 2", "scope": "submit", "key_id": key}
    listed = keyed.get("/v1/keys")
    assert secret not in listed.text
    assert next(item for item in listed.json()["keys"] if item["id"] == key)["last_used_at"] is not None
    new = keyed.post(f"/v1/keys/{key}/rotate").json()["secret"]
    assert keyed.get("/v1/keys/own", headers=bearer).status_code == 401
    assert keyed.get("/v1/keys/own", headers={"Authorization": f"Bearer {new}"}).status_code == 200
    assert keyed.delete(f"/v1/keys/{key}").json()["revoked_at"] is not None
    assert refusal(keyed.get("/v1/keys/own", headers={"Authorization": f"Bearer {new}"})) == (401, "token-required")
    assert [entry.who for entry in store.audit.page(limit=3).items] == [administrator.name] * 3


def test_a_job_keeps_the_key_that_asked_for_it(keyed, store):
    key = keyed.bring(Scope.SUBMIT)
    answer = keyed.post("/v1/calibrations", json={"scan_id": "example"})
    asked = answer.json()
    assert (answer.headers["X-Key-Id"], answer.headers["X-Job-Id"]) == (key.id, asked["job_id"])
    assert "X-Job-Id" not in keyed.get("/v1/scanners").headers
    with store.database.read() as session:
        assert session.get(JobRow, asked["job_id"]).key_id == key.id


def test_the_token_stays_the_first_administrator_s_key_even_while_the_database_is_away(keyed, store):
    keyed.app = create_app(ServiceSettings(token=TOKEN), store, print)
    keyed.headers = {"Authorization": f"Bearer {TOKEN}"}
    assert keyed.get("/v1/keys").status_code == 200
    key = keyed.bring(Scope.READ)
    assert (keyed.get("/v1/scanners").status_code, keyed.get("/v1/keys").json()["code"]) == (200, "scope-too-small")
    assert key.secret not in keyed.get("/v1/keys").text
    with database_away(store.database):
        answer = keyed.get("/v1/keys/own", headers={"Authorization": "Bearer sawmill_any"})
        assert (answer.status_code, answer.json()["code"]) == (503, "storage-unavailable")
        assert answer.headers["Retry-After"] == "5"
        assert keyed.get("/v1/keys/own", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200


@pytest.mark.parametrize(
    "trace",
    [
        {"X-Forwarded-For": "192.0.2.7"},
        {"Forwarded": "for=192.0.2.7"},
        {"X-Real-IP": "192.0.2.7"},
        {"Via": "1.1 proxy"},
        {"X-Forwarded-Proto": "https"},
        {"X-Client-IP": "192.0.2.7"},
        # What a proxy does not touch: the page that the browser shows.
        {"Referer": "https://calibration.mill.example/docs"},
    ],
)
def test_an_open_service_is_not_open_to_a_proxy(client, trace):
    assert client.get("/v1/scanners").status_code == 200
    answer = client.get("/v1/scanners", headers=trace)
    assert (answer.status_code, answer.json()["code"]) == (401, "token-required")
    assert "came through a proxy" in answer.json()["detail"]


@pytest.mark.parametrize("settings", [BEHIND, ServiceSettings(public_url="http://[2001:db8::7]:8443")])
def test_a_public_url_is_an_allowed_host_and_asks_for_keys(client, store, settings):
    client.app = create_app(settings, store, print)
    public = {"Host": settings.public_url.partition("://")[2]}
    assert client.get("/health/live", headers=public).status_code == 200
    assert client.get("/v1/scanners", headers=public).status_code == 401
    assert client.get("/v1/scanners").status_code == 401


@pytest.mark.parametrize(
    ("variables", "sentence"),
    [
        ({"public_url": "calibration.mill.example"}, "must be as in https://calibration.mill.example, without a path"),
        ({"public_url": "https://mill.example/calibration"}, "without a path, not 'https://mill.example/calibration'"),
        ({"trusted_proxies": ["10.0.0.7/8"]}, "must be IP addresses or networks"),
    ],
)
def test_a_proxy_is_named_as_it_must_be(variables, sentence):
    with pytest.raises(ValueError, match=sentence):
        ServiceSettings(**variables)


def test_an_open_service_is_open_by_the_names_of_loopback_alone(client, store):
    client.app = create_app(ServiceSettings(allowed_hosts=["mill.example"]), store, print)
    assert refusal(client.get("/v1/scanners", headers={"Host": "mill.example"})) == (401, "token-required")
    assert client.get("/v1/scanners", headers={"Host": "localhost:8000"}).status_code == 200


def test_who_only_looks_may_look_while_nothing_can_be_written(keyed, store, log_lines):
    keyed.bring(Scope.READ)
    with write_lock(store.files.folder / "sawmill.db"):
        assert keyed.get("/v1/scanners").status_code == 200
    assert "use-not-kept" in {line["event"] for line in log_lines()}


def test_a_path_with_a_slash_too_many_is_not_redirected_to_another_scheme(keyed):
    keyed.bring(Scope.READ)
    assert keyed.get("/v1/scanners/").status_code == 404


OPEN = {"/health/live", "/health/ready"}
PAGES = {"/", "/docs", "/openapi.json", "/static/console.js", "/console/swagger-ui.css", "/no/such/path"}


def basic(user: str, password: str) -> str:
    return f"Basic {b64encode(f'{user}:{password}'.encode()).decode()}"


@pytest.fixture
def guarded(seeded, store, settings):
    """A client without the token of a service that asks for one."""
    seeded.app = create_app(ServiceSettings(**settings.model_dump() | {"token": TOKEN}), store, print)
    return seeded


@pytest.mark.slow
def test_everything_but_health_needs_the_token(guarded):
    documented = {path.replace("{", "").replace("}", "") for path in guarded.app.openapi()["paths"]}
    for path in documented | PAGES:
        for method in ("GET", "POST", "HEAD", "OPTIONS"):
            answer = guarded.request(method, path)
            is_open = path in OPEN or (path.startswith("/problems/") and method != "POST")
            assert (answer.status_code == 401) is not is_open, (method, path, answer.status_code)
    assert [guarded.get(path).status_code for path in sorted(OPEN)] == [200, 200]


@pytest.mark.parametrize(
    "brought",
    [f"Bearer {TOKEN}", f"bearer  {TOKEN}", basic("", TOKEN), basic("anybody", TOKEN)],
    ids=["bearer", "lower-case", "nobody", "anybody"],
)
def test_the_token_opens_as_a_bearer_s_and_as_a_password(guarded, brought):
    guarded.headers = {"Authorization": brought}
    assert [guarded.get(path).status_code for path in ("/", "/docs", "/v1/scanners", "/metrics")] == [200] * 4
    assert guarded.post("/v1/calibrations/example/activate").status_code == 200


@pytest.mark.parametrize(
    "brought",
    [
        "",
        TOKEN,
        "Bearer",
        f"Bearer {TOKEN}x",
        f"Bearer {TOKEN[:-1]}",
        f"Token {TOKEN}",
        basic(TOKEN, ""),
        basic("anybody", TOKEN.lower()),
        "Basic not*base64",
        "Basic " + b64encode(TOKEN.encode()).decode(),
        "Bearer \xff\xfe",
        "Basic \xfc\xfc",
    ],
)
def test_nothing_else_opens(guarded, brought):
    answer = guarded.get("/v1/scanners", headers={"Authorization": brought.encode("latin-1")})
    assert (answer.status_code, answer.json()["code"]) == (401, "token-required")
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert [challenge.split()[0] for challenge in answer.headers.get_list("WWW-Authenticate")] == ["Basic", "Bearer"]
    assert TOKEN not in answer.text


def test_the_token_may_come_from_a_file_and_the_settings_do_not_show_it(tmp_path):
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    settings = ServiceSettings(token_file=tmp_path / "token")
    assert settings.token.get_secret_value() == TOKEN
    assert not re.search(TOKEN, f"{settings!r}{settings!s}{settings.model_dump()}{settings.model_dump_json()}")


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"token": ""}, "at least 32 characters, not 0"),
        ({"token": TOKEN[:31]}, "at least 32 characters, not 31"),
        ({"token": "a token with spaces, of enough characters"}, "without spaces"),
        ({"token": TOKEN, "token_file": "token"}, "SAWMILL_TOKEN or SAWMILL_TOKEN_FILE, not both"),
        ({"token_file": "no-such-file"}, "SAWMILL_TOKEN_FILE cannot be read: .*'no-such-file'"),
    ],
)
def test_a_token_that_cannot_be_is_refused_and_not_shown(given, complaint):
    with pytest.raises(ValidationError, match=complaint) as refused:
        ServiceSettings(**given)
    assert not given.get("token") or given["token"] not in f"{refused.value!s}{refused.value!r}"
