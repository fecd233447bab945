"""The token and keys: what needs one, what each scope may do, that a secret is shown once, and who did what."""

import json
import re
from base64 import b64encode

import pytest
from asgi import refusal
from live_service import write_lock
from machine_faults import database_away
from pydantic import ValidationError
from results import SCANNER_SPEC as SPEC
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_contracts import mill_events
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.plans import PlanRequest
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.database.tables import JobRow
from sawmill_service.app import create_app
from sawmill_service.http.route_rules import NoKey, Router, RouteRules
from sawmill_service.settings import ServiceSettings

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
BEHIND = ServiceSettings(public_url="https://calibration.mill.example", trusted_proxies=["127.0.0.1"])


@pytest.fixture
def keyed(seeded, store):
    seeded.app = create_app(BEHIND, store, print)
    return seeded


def rules(app):
    by_pattern = app.state.rules.by_pattern
    return {(method, path): rule for path, methods in by_pattern.items() for method, rule in methods.items()}


@pytest.mark.parametrize("scope", list(Scope))
def test_a_key_may_do_what_its_scope_covers_and_nothing_else(keyed, scope):
    keyed.bring(scope)
    described = keyed.app.openapi()["paths"].items()
    for path, method in ((path, method.upper()) for path, item in described for method in item.keys() - {"head"}):
        if path == "/metrics" or path.endswith("/events"):
            continue  # a stream that does not end here
        where = path.replace("{", "").replace("}", "").replace("_id", "")
        answer = keyed.request(method, where, json={} if method in {"POST", "PUT"} else None)
        refused, needed = answer.status_code == 403, rules(keyed.app)[method, path].scope
        assert refused is not scope.covers(needed), (method, path, answer.text)
        if refused:
            assert answer.json()["code"] == "scope-too-small"
            assert f"of the scope {needed}" in answer.json()["detail"]


def test_what_decides_or_removes_needs_more_than_work_and_a_route_without_a_scope_does_not_start(keyed):
    needs = {operation: rule.scope for operation, rule in rules(keyed.app).items()}
    assert {" ".join(operation) for operation, scope in needs.items() if scope is Scope.ACTIVATE} == {
        *("POST /v1/scanners", "PUT /v1/scanners/{scanner_id}", "POST /v1/schedules", "POST /scanners/new"),
        *("PUT /v1/schedules/{schedule_id}", "DELETE /v1/schedules/{schedule_id}"),
        *(f"POST /v1/calibrations/{{calibration_id}}/{act}" for act in ("activate", "discard")),
        *(f"POST /operator/{act}/{{calibration_id}}" for act in ("activate", "discard")),
        "POST /operator/acknowledge/{scanner_id}",
        *("POST /v1/scanners/{scanner_id}/red/acknowledge", "POST /operator/time-zone"),
        *("POST /operator/acknowledge/{scanner_id}/{kind}", "POST /v1/scanners/{scanner_id}/alarms/{kind}/acknowledge"),
        *("POST /scanners/{scanner_id}/settings", "POST /scanners/{scanner_id}/schedules"),
        "POST /scanners/{scanner_id}/schedules/{schedule_id}/delete",
    }
    administration = {path for (_, path), scope in needs.items() if scope is Scope.ADMIN}
    assert administration >= {"/v1/keys", "/v1/keys/{key_id}", "/v1/keys/{key_id}/rotate", "/v1/scans/{scan_id}"}
    assert {scope for (method, _), scope in needs.items() if method == "GET"} == {Scope.READ, Scope.ADMIN}
    changing = {operation for operation, scope in needs.items() if operation[0] != "GET" and scope is Scope.READ}
    assert changing == {("POST", "/login"), ("POST", "/logout")}
    assert all(needs["POST", kind.asked_at or f"/v1/{kind.kind.plural}"] is Scope.SUBMIT for kind in asked_kinds())
    assert {path: rule.needs for (_, path), rule in rules(keyed.app).items() if isinstance(rule.needs, NoKey)} == {
        **dict.fromkeys(("/health/live", "/health/ready"), NoKey.MONITORING),
        **dict.fromkeys(("/login", "/login/{link}", "/look"), NoKey.LOGIN),
        **dict.fromkeys(("/problems", "/problems/", "/problems/{code}"), NoKey.AFTER_REFUSAL),
    }
    for method, reading in (("GET", None), ("POST", None), ("POST", Scope.READ)):
        router = Router(reading=reading)
        getattr(router, method.lower())("/v1/forgotten")(lambda: None)
        assert isinstance(keyed.app.state.rules, RouteRules), "made at the start"
        with pytest.raises(ValueError, match=f"{method} /v1/forgotten declares no scope"):
            RouteRules([*keyed.app.routes, *router.routes])


def test_a_job_keeps_its_key_and_who_may_not_activate_cannot_ask_for_it_on_pass(keyed, store):
    keyed.bring(Scope.SUBMIT)
    ask = {"scan_id": "example", "activate": True}
    assert keyed.post("/v1/calibrations", json=ask).json()["code"] == "scope-too-small"
    assert keyed.post("/v1/calibrations", json=ask | {"activate": False}).status_code == 202
    keyed.bring(Scope.ACTIVATE)
    assert keyed.post("/v1/calibrations", json=ask).status_code == 202
    key = keyed.bring(Scope.SUBMIT)
    answer = keyed.post("/v1/calibrations", json={"scan_id": "example"})
    asked = answer.json()
    assert (answer.headers["X-Key-Id"], answer.headers["X-Job-Id"]) == (key.id, asked["job_id"])
    assert "X-Job-Id" not in keyed.get("/v1/scanners").headers
    with store.database.read() as session:
        assert session.get(JobRow, asked["job_id"]).key_id == key.id


def test_a_key_is_made_used_rotated_and_revoked(keyed, store):
    administrator = keyed.bring(Scope.ADMIN)
    made = keyed.post("/v1/keys", json={"name": "scanner of line 2", "scope": "submit"})
    assert (made.status_code, made.headers["Cache-Control"]) == (201, "no-store")
    assert made.json()["created_by"] == administrator.name
    key, secret = made.json()["id"], made.json()["secret"]
    bearer = {"Authorization": f"Bearer {secret}"}
    own = keyed.get("/v1/keys/current", headers=bearer).json()
    assert own == {"name": "scanner of line 2", "scope": "submit", "key_id": key}
    listed = keyed.get("/v1/keys")
    assert secret not in listed.text
    assert next(item for item in listed.json()["items"] if item["id"] == key)["last_used_at"] is not None
    new = keyed.post(f"/v1/keys/{key}/rotate").json()["secret"]
    assert keyed.get("/v1/keys/current", headers=bearer).status_code == 401
    assert keyed.get("/v1/keys/current", headers={"Authorization": f"Bearer {new}"}).status_code == 200
    assert keyed.delete(f"/v1/keys/{key}").json()["revoked_at"] is not None
    assert refusal(keyed.get("/v1/keys/current", headers={"Authorization": f"Bearer {new}"})) == (401, "token-required")
    assert [entry.who for entry in store.audit.page(limit=3).items] == [administrator.name] * 3


def test_the_token_stays_the_first_administrator_s_key_even_while_the_database_is_away(keyed, store):
    keyed.app = create_app(ServiceSettings(token=TOKEN), store, print)
    keyed.headers = {"Authorization": f"Bearer {TOKEN}"}
    assert keyed.get("/v1/keys").status_code == 200
    key = keyed.bring(Scope.READ)
    assert (keyed.get("/v1/scanners").status_code, keyed.get("/v1/keys").json()["code"]) == (200, "scope-too-small")
    assert key.secret not in keyed.get("/v1/keys").text
    with database_away(store.database):
        answer = keyed.get("/v1/keys/current", headers={"Authorization": "Bearer sawmill_any"})
        assert refusal(answer) == (503, "storage-unavailable")
        assert answer.headers["Retry-After"] == "5"
        assert keyed.get("/v1/keys/current", headers={"Authorization": f"Bearer {TOKEN}"}).status_code == 200


def test_an_open_service_is_open_on_loopback_alone_and_to_no_proxy(client, store):
    assert client.get("/v1/scanners").status_code == 200
    traces = dict.fromkeys(("X-Forwarded-For", "X-Real-IP", "X-Client-IP"), "192.0.2.7") | {
        "Forwarded": "for=192.0.2.7"
    }
    # The last is what a proxy does not touch: the page that the browser shows.
    traces |= {"Via": "1.1 proxy", "X-Forwarded-Proto": "https", "Referer": "https://calibration.mill.example/docs"}
    for trace in traces.items():
        answer = client.get("/v1/scanners", headers=dict([trace]))
        assert refusal(answer) == (401, "token-required"), trace
        assert "came through a proxy" in answer.json()["detail"]
    for settings in (BEHIND, ServiceSettings(public_url="http://[2001:db8::7]:8443")):
        client.app = create_app(settings, store, print)
        public = {"Host": settings.public_url.partition("://")[2]}
        assert client.get("/health/live", headers=public).status_code == 200
        assert client.get("/v1/scanners", headers=public).status_code == 401
        assert client.get("/v1/scanners").status_code == 401
    client.app = create_app(ServiceSettings(allowed_hosts=["mill.example"]), store, print)
    assert refusal(client.get("/v1/scanners", headers={"Host": "mill.example"})) == (401, "token-required")
    assert client.get("/v1/scanners", headers={"Host": "localhost:8000"}).status_code == 200


def test_who_only_looks_may_look_while_nothing_can_be_written_and_is_redirected_nowhere(keyed, store, log_lines):
    keyed.bring(Scope.READ)
    with write_lock(store.files.folder / "sawmill.db"):
        assert keyed.get("/v1/scanners").status_code == 200
    assert "use-not-kept" in {line["event"] for line in log_lines()}
    assert keyed.get("/v1/scanners/").status_code == 404  # and not another scheme


OPEN = {"/health/live", "/health/ready"}
PAGES = {"/", "/docs", "/openapi.json", "/static/console.js", "/console/swagger-ui.css", "/no/such/path"}


def basic(user: str, password: str) -> str:
    return f"Basic {b64encode(f'{user}:{password}'.encode()).decode()}"


@pytest.fixture
def guarded(seeded, store, settings):
    seeded.app = create_app(ServiceSettings(**settings.model_dump() | {"token": TOKEN}), store, print)
    return seeded


@pytest.mark.slow
def test_everything_but_health_needs_the_token(guarded):
    for path in {path.replace("{", "").replace("}", "") for path in guarded.app.openapi()["paths"]} | PAGES:
        for method in ("GET", "POST", "HEAD", "OPTIONS"):
            answer = guarded.request(method, path)
            is_open = path in OPEN or (path.startswith("/problems/") and method != "POST")
            assert (answer.status_code == 401) is not is_open, (method, path, answer.status_code)
    assert [guarded.get(path).status_code for path in sorted(OPEN)] == [200, 200]


def test_the_token_opens_as_a_bearer_s_and_as_a_password_and_nothing_else_does(guarded):
    for brought in (
        *("", TOKEN, "Bearer", f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Token {TOKEN}", basic(TOKEN, "")),
        *(basic("anybody", TOKEN.lower()), "Basic not*base64", f"Basic {b64encode(TOKEN.encode()).decode()}"),
        *("Bearer \xff\xfe", "Basic \xfc\xfc"),
    ):
        answer = guarded.get("/v1/scanners", headers={"Authorization": brought.encode("latin-1")})
        assert (*refusal(answer), answer.headers["Content-Type"]) == (401, "token-required", "application/problem+json")
        assert [each.split()[0] for each in answer.headers.get_list("WWW-Authenticate")] == ["Basic", "Bearer"]
        assert TOKEN not in answer.text
    for brought in (f"Bearer {TOKEN}", f"bearer  {TOKEN}", basic("", TOKEN), basic("anybody", TOKEN)):
        guarded.headers = {"Authorization": brought}
        assert [guarded.get(path).status_code for path in ("/", "/docs", "/v1/scanners", "/metrics")] == [200] * 4
        assert guarded.post("/v1/calibrations/example/activate").status_code == 200


def test_a_token_may_come_from_a_file_and_is_never_shown(tmp_path):
    (tmp_path / "token").write_text(f"{TOKEN}\n")
    settings = ServiceSettings(token_file=tmp_path / "token")
    assert settings.token.get_secret_value() == TOKEN
    assert not re.search(TOKEN, f"{settings!r}{settings!s}{settings.model_dump()}{settings.model_dump_json()}")
    for given, complaint in (
        ({"public_url": "calibration.mill.example"}, "must be as in https://calibration.mill.example, without a path"),
        ({"public_url": "https://mill.example/calibration"}, "without a path, not 'https://mill.example/calibration'"),
        ({"trusted_proxies": ["10.0.0.7/8"]}, "must be IP addresses or networks"),
        ({"token": ""}, "at least 32 characters, not 0"),
        ({"token": TOKEN[:31]}, "at least 32 characters, not 31"),
        ({"token": "a token with spaces, of enough characters"}, "without spaces"),
        ({"token": TOKEN, "token_file": "token"}, "SAWMILL_TOKEN or SAWMILL_TOKEN_FILE, not both"),
        ({"token_file": "no-such-file"}, "SAWMILL_TOKEN_FILE cannot be read: .*'no-such-file'"),
    ):
        with pytest.raises(ValidationError, match=complaint) as refused:
            ServiceSettings(**given)
        assert not given.get("token") or given["token"] not in f"{refused.value!s}{refused.value!r}"


DISC = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
SCHEDULE = {"scanner_id": "example", "cron": "30 5 * * 1-6", "enabled": False}


@pytest.fixture
def anna(seeded, store):
    seeded.app = create_app(ServiceSettings(public_url="https://calibration.mill.example"), store, print)
    seeded.key = seeded.bring(Scope.ADMIN, name="anna")
    return seeded


@pytest.mark.usefixtures("_another_is_active")
def test_every_decision_is_entered_with_who_made_it_and_read_over_http_and_as_a_file(anna, store, tmp_path):
    before = store.audit.page().items[0].number
    scanner = anna.post("/v1/scanners", json=SPEC).json()["id"]
    anna.put(f"/v1/scanners/{scanner}", json=SPEC | {"tolerances": {"predicted_ray_error_mm": 5.0}})
    anna.delete(f"/v1/scanners/{scanner}")
    schedule = anna.post("/v1/schedules", json=SCHEDULE).json()["id"]
    anna.put(f"/v1/schedules/{schedule}", json=SCHEDULE | {"on_pass": "activate"})
    anna.delete(f"/v1/schedules/{schedule}")
    anna.post("/v1/calibrations/example/activate", json={"reason": "checked by hand"})
    job = anna.post("/v1/calibrations", json={"scan_id": "example"}).json()["job_id"]
    anna.post(f"/v1/jobs/{job}/cancel")
    anna.post(f"/v1/jobs/{job}/cancel")  # has ended: nobody does anything
    anna.delete("/v1/scans/example")
    phantom = anna.post("/v1/phantoms", json=DISC).json()["id"]
    anna.delete(f"/v1/phantoms/{phantom}")
    entries = [entry for entry in store.audit.all() if entry.number > before]
    assert [entry.action for entry in entries] == [
        *(mill_events.SCANNER_CREATED, mill_events.SCANNER_CHANGED, mill_events.SCANNER_DELETED),
        *(mill_events.SCHEDULE_CREATED, mill_events.SCHEDULE_CHANGED, mill_events.SCHEDULE_DELETED),
        *(mill_events.CALIBRATION_ROLLED_BACK, event_kinds.JOB_CANCELLED),
        *(mill_events.SCAN_DELETED, mill_events.PHANTOM_DELETED),
    ]
    assert {(entry.who, entry.key_id, entry.address) for entry in entries} == {("anna", anna.key.id, "127.0.0.1")}
    was, now = entries[1].detail["tolerances"]
    assert (was["predicted_ray_error_mm"], now["predicted_ray_error_mm"]) == (0.1, 5.0)
    assert entries[4].detail == {"on_pass": ["report", "activate"]}
    assert entries[6].detail == {"scanner_id": "example", "reason": "checked by hand"}
    anna.delete("/v1/scans/example")
    entries = list(store.audit.all())
    first = anna.get("/v1/audit?limit=1").json()
    assert first["items"][0]["number"] == entries[-1].number
    following = anna.get("/v1/audit", params={"after": first["next"]}).json()["items"]
    assert [item["number"] for item in following] == [entry.number for entry in reversed(entries[:-1])]
    answer = anna.get("/v1/audit.jsonl")
    assert answer.headers["Content-Type"] == "application/jsonl"
    lines = [json.loads(line) for line in answer.text.splitlines()]
    assert lines == [entry.model_dump(mode="json") for entry in entries]
    out = tmp_path / "audit.jsonl"
    done = CliRunner().invoke(main, ["audit", "--data", str(store.files.folder), "--output", str(out)])
    assert (done.exit_code, out.read_text()) == (0, answer.text)


def test_what_is_refused_leaves_no_entry_and_an_activation_names_the_key_that_asked(anna, store, worker):
    before = store.audit.page().items
    assert anna.delete("/v1/scanners/example").status_code == 409
    assert anna.put("/v1/scanners/nobody", json=SPEC).status_code == 404
    assert (anna.delete("/v1/phantoms/l-shape").status_code, store.audit.page().items) == (409, before)
    anna.post("/v1/calibrations", json={"scan_id": "example", "activate": True})
    worker.finish_calibration()
    newest = store.audit.page(limit=1).items[0]
    assert (newest.action, newest.who, newest.key_id) == (mill_events.CALIBRATION_ACTIVATED, "anna", anna.key.id)
    assert "the request asked for activation on pass" in newest.detail["reason"]


# A page: what it hides from a key to read, what it says to it, and what the key may not press.
LOOKED_AT = {
    "/jobs": (["Yes, cancel it"], "", ["/jobs/{job}/cancel"]),
    "/phantoms/new": ([], "Your key may only look", ["/phantoms/preview"]),
    "/phantoms/l-shape": (["Measure it again", "Compute the plan"], "", ["/phantoms/l-shape/delete"]),
    "/scanners/example": (["/calibrate?scanner=example"], "", ["/scanners/example/settings"]),
    "/scans/example": (
        *(["/scans/example/reconstruct", "/scans/example/delete"], ""),
        ["/scans/example/reconstruct", "/scans/example/delete"],
    ),
    "/calibrate": (['type="file"'], "Your key may only look", ["/calibrate", "/calibrate/dataset"]),
}


@pytest.mark.parametrize("page", LOOKED_AT)
def test_whoever_may_only_look_finds_no_buttons_and_cannot_press_them(seeded, store, page):
    plan = store.plans.accept(PlanRequest(scanner_id="example"), given={"phantom_id": "l-shape"})
    hidden, said, forms = LOOKED_AT[page]
    shown = seeded.get(page).text
    assert [text for text in hidden if text not in shown] == [], "who may press them has them"
    seeded.bring(Scope.READ)
    shown = seeded.get(page).text
    assert said in shown
    assert [text for text in hidden if text in shown] == []
    for form in forms:
        assert refusal(seeded.post(form.format(job=plan.job_id), json={"shapes": []})) == (403, "scope-too-small")
