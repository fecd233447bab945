"""Browsers log in with a key: what the session may do, who cannot use it, and when it ends."""

import re
from datetime import UTC, datetime, timedelta
from urllib.parse import parse_qs, urlsplit

import pytest
from asgi import absent, refusal
from machine_faults import database_away
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_platform.keys.key_store import hash_of, hash_of_link
from sawmill_service.access import LOGIN, SECURE_SESSION_COOKIE, SESSION_COOKIE, csrf_token
from sawmill_service.app import create_app
from sawmill_service.pages.frame.page_frame import LOOK
from sawmill_service.routes.login import FILES
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
GUARDED = ServiceSettings(token=TOKEN)
HTML = {"Accept": "text/html,application/xhtml+xml"}
ORIGIN = "http://127.0.0.1:8000"


@pytest.fixture
def browser(seeded, store):
    """A client of a service that asks for keys, which can log in and then sends its cookie, and Accept as browsers."""
    seeded.app = create_app(GUARDED, store, print)
    seeded.headers = dict(HTML)
    return seeded


def key_of(store, scope, **changes):
    return store.keys.create(KeyRequest(name=f"Anna <{scope}>", scope=scope, **changes))


def log_in(browser, secret, **fields):
    """As the login's form sends it; the client brings the cookie from now on."""
    answer = browser.post("/login", data={"key": secret, **fields}, headers={"Origin": ORIGIN})
    if answer.status_code == 303:
        browser.headers["Cookie"] = answer.headers["Set-Cookie"].partition(";")[0]
    return answer


def code(answer):
    assert answer.headers["Content-Type"].startswith("text/html")
    return re.search(r"/problems/([\w-]+)", answer.text)[1]


def session_of(browser):
    return browser.headers["Cookie"].partition("=")[2]


def token_in(browser):
    return re.search(r'name="csrf" value="(\w+)"', browser.get("/").text)[1]


def test_a_key_opens_a_session_in_a_cookie_that_scripts_cannot_read(browser):
    for secret in (TOKEN, f" {TOKEN}\n"):
        answer = log_in(browser, secret)
        assert (answer.status_code, answer.headers["Location"]) == (303, "/")
        name, *flags = answer.headers["Set-Cookie"].split("; ")
        assert re.fullmatch(rf"{SESSION_COOKIE}=[\w-]{{43}}", name)
        assert sorted(flags) == ["HttpOnly", "Path=/", "SameSite=lax"]
        assert TOKEN not in answer.headers["Set-Cookie"]
        page = browser.get("/")
        assert (page.status_code, page.headers["Cache-Control"]) == (200, "no-store")
        assert browser.get("/v1/keys/current").json()["scope"] == "admin"


def test_with_tls_the_cookie_is_for_tls_and_this_host_alone(browser, store):
    for public_url, there in (("https://calibration.mill.example", ""), (None, "https://127.0.0.1:8000")):
        browser.app = create_app(ServiceSettings(public_url=public_url, token=TOKEN), store, print)
        answer = browser.post(f"{there}/login", data={"key": key_of(store, Scope.READ).secret})
        assert answer.headers["Set-Cookie"].startswith(f"{SECURE_SESSION_COOKIE}=")
        assert answer.headers["Set-Cookie"].endswith("HttpOnly; Path=/; SameSite=lax; Secure")
        # A plain cookie, which another host of the domain or plain HTTP can set, opens nothing there.
        forged = answer.headers["Set-Cookie"].replace(SECURE_SESSION_COOKIE, SESSION_COOKIE)
        assert browser.get(f"{there}/v1/keys/current", headers={"Cookie": forged, "Accept": "*/*"}).status_code == 401
        good = answer.headers["Set-Cookie"].partition(";")[0]
        assert browser.get(f"{there}/v1/keys/current", headers={"Cookie": good}).status_code == 200


def test_a_wrong_key_has_its_sentence_and_too_many_of_an_address_are_refused(browser, store):
    for secret in ("", "sawmill_none", TOKEN[:-1], "\xfc"):
        answer = log_in(browser, secret, next="/docs")
        assert answer.status_code == 401
        assert absent(answer.text, "This key opens nothing here", 'name="next" value="/docs"') == []
        assert "Set-Cookie" not in answer.headers
        assert not answer.headers["WWW-Authenticate"].startswith("Basic")
    assert event_kinds.LOGGED_IN not in {entry.action for entry in store.audit.all()}
    browser.app = create_app(ServiceSettings(token=TOKEN, failed_login_rate_limit="2/day"), store, print)
    good = store.keys.create(KeyRequest(name="line 2", scope=Scope.READ))
    assert log_in(browser, "sawmill_wrong").status_code == 401
    wrong = {"Authorization": "Bearer sawmill_wrong_too"}
    assert browser.get("/v1/scanners", headers=wrong).status_code == 401
    page = log_in(browser, "sawmill_wrong_as_well")
    assert (page.status_code, page.headers["Content-Type"]) == (429, "text/html; charset=utf-8")
    assert "127.0.0.1 may send 2 wrong keys in 86400 s" in page.text
    assert 1 <= int(page.headers["Retry-After"]) <= 86400
    another = browser.get("/v1/scanners", headers={"Authorization": "Bearer sawmill_and_another"})
    assert refusal(another) == (429, "too-many-requests")
    assert browser.get("/v1/scanners", headers={"Authorization": f"Bearer {good.secret}"}).status_code == 200
    with database_away(store.database) as met:
        assert browser.get("/v1/scanners", headers=wrong).status_code == 401
        assert not met.is_set(), "a key that is known to be wrong is not looked up"
    assert log_in(browser, TOKEN).status_code == 303


def test_a_page_leads_to_the_login_and_from_there_on_and_to_no_other_site(browser):
    asked = browser.get("/v1/calibrations/example/report.png?dpi=50")
    assert asked.status_code == 303
    location = urlsplit(asked.headers["Location"])
    onward = parse_qs(location.query)["next"][0]
    assert (location.path, onward) == ("/login", "/v1/calibrations/example/report.png?dpi=50")
    assert 'value="/v1/calibrations/example/report.png?dpi=50"' in browser.get(asked.headers["Location"]).text
    assert log_in(browser, TOKEN, next=onward).headers["Location"] == onward
    # A button that was pressed after the session's end: nothing was done, and its page comes back.
    del browser.headers["Cookie"]
    pressed = {"Referer": f"{ORIGIN}/calibrate?calibration=example"}
    ended = browser.post("/operator/activate/example", headers=pressed).headers["Location"]
    assert parse_qs(urlsplit(ended).query) == {"next": ["/calibrate?calibration=example"], "ended": ["true"]}
    assert "Your session has ended; nothing was changed" in browser.get(ended).text
    elsewhere = ("//evil.example", "https://evil.example", "/\\evil.example", "/\t/evil.example", "javascript:x")
    for onward in (*elsewhere, "", "x", "/..//evil.example", "/.//evil.example", "/a//b?next=/c"):
        assert log_in(browser, TOKEN, next=onward).headers["Location"] == "/", onward
        assert 'name="next" value="/"' in browser.get("/login", params={"next": onward}).text, onward


def test_without_a_session_programs_are_challenged_as_before_and_only_the_login_is_open(browser):
    def challenges(**headers):
        answer = browser.get("/v1/scanners", headers={"Accept": "*/*", **headers})
        assert refusal(answer) == (401, "token-required")
        return [challenge.split()[0] for challenge in answer.headers.get_list("WWW-Authenticate")]

    assert challenges() == challenges(Authorization="Bearer none") == ["Basic", "Bearer"]
    assert challenges(Cookie=f"{SESSION_COOKIE}=ended") == challenges(**{"Sec-Fetch-Mode": "cors"}) == ["Bearer"]
    page = browser.get("/login")
    assert page.status_code == 200
    named, open_paths = set(re.findall(r'(?:src|href|action)="([^"]+)"', page.text)), {*FILES, LOGIN, LOOK}
    assert named == open_paths | {"/", "#content"}
    assert {browser.get(path).status_code for path in open_paths} == {200, 303}
    for path in ("/static/console.js", "/console/swagger-ui.css", "/login/", "/static/pages/base.css/..", "/loginx"):
        assert browser.get(path, headers={"Accept": "*/*"}).status_code == 401, path


@pytest.mark.usefixtures("newer")
def test_the_cookie_alone_changes_nothing(browser, store):
    log_in(browser, TOKEN)
    token, form = token_in(browser), "application/x-www-form-urlencoded"
    for brought in (
        {},
        {"data": {"csrf": ""}},
        {"data": {"csrf": csrf_token("of another session")}},
        {"data": {"csrf": "\xfc"}},
        {"headers": {"X-CSRF-Token": token[:-1]}},
        {"content": f"csrf={token}", "headers": {"Content-Type": "text/plain"}},
        {"content": f"csrf={token}&x={'x' * 9000}", "headers": {"Content-Type": form}},
        {"content": f"csrf={token}" + "&x=x" * 30, "headers": {"Content-Type": form}},
        {"content": b"csrf=\xff", "headers": {"Content-Type": form}},
    ):
        answer = browser.post("/operator/activate/newer", **brought)
        assert code(answer) in {"csrf", "bad-form", "body-too-large"}, brought
    for method, path in (("POST", "/logout"), ("POST", "/v1/scanners"), ("DELETE", "/v1/scans/example-spare")):
        answer = browser.request(method, path, json={})
        assert answer.status_code in {403, 422}
    assert code(browser.delete("/v1/scans/example-spare")) == "csrf"
    assert store.scanners.get("example").active_calibration_id == "example"
    assert browser.post("/operator/activate/newer", data={"csrf": token}).headers["Location"] == "/"
    assert store.scanners.get("example").active_calibration_id == "newer"
    assert browser.delete("/v1/scans/example-spare", headers={"X-CSRF-Token": token}).status_code == 204


def test_another_site_can_use_no_session_nor_log_its_visitor_in_and_who_brings_a_key_needs_no_token(browser):
    log_in(browser, TOKEN)
    token = token_in(browser)
    for foreign in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
        answer = browser.post("/operator/activate/example", data={"csrf": token}, headers=foreign)
        assert code(answer) == "other-site"
        answer = browser.post("/login", data={"key": TOKEN}, headers=foreign)
        assert (code(answer), "Set-Cookie" in answer.headers) == ("other-site", False)
    browser.headers = {"Authorization": f"Bearer {TOKEN}"}
    assert browser.post("/operator/activate/example").status_code == 303
    assert "Log out" not in browser.get("/").text


@pytest.mark.usefixtures("newer")
@pytest.mark.parametrize("scope", list(Scope))
def test_pages_show_who_is_logged_in_and_the_buttons_that_he_may_press(browser, store, scope):
    log_in(browser, key_of(store, scope).secret)
    page, console = browser.get("/").text, browser.get("/docs").text
    for shown in (page, console):
        assert absent(shown, f"<span>Anna &lt;{scope}&gt;</span>", 'action="/logout"') == []
    token = token_in(browser)
    assert f'<meta name="csrf-token" content="{token}">' in console
    may = scope.covers(Scope.ACTIVATE)
    assert ("/calibrate?scanner=" in page) is scope.covers(Scope.SUBMIT)
    forged = browser.post("/operator/activate/newer", data={"csrf": token})
    assert forged.status_code == (303 if may else 403)
    assert may or code(forged) == "scope-too-small"


def test_a_logout_and_another_login_end_the_session_and_both_are_in_the_audit(browser, store):
    key = key_of(store, Scope.READ)
    log_in(browser, key.secret)
    answer = browser.post("/logout", data={"csrf": token_in(browser)})
    assert (answer.status_code, answer.headers["Location"]) == (303, "/login")
    assert answer.headers["Set-Cookie"].startswith(f'{SESSION_COOKIE}=""; HttpOnly; Max-Age=0;')
    assert browser.get("/").headers["Location"] == "/login?next=%2F&ended=true"
    went, came = store.audit.page(limit=2).items
    assert (came.action, went.action) == (event_kinds.LOGGED_IN, event_kinds.LOGGED_OUT)
    assert ({entry.who for entry in (came, went)}, {entry.key_id for entry in (came, went)}) == ({key.name}, {key.id})
    assert came.address == "127.0.0.1"
    log_in(browser, TOKEN)
    shown = [browser.get(f"/audit{query}").text.count("<td>logged in with") for query in ("", "?logins=yes")]
    assert (shown[0], shown[1] > 0) == (0, True)
    before = session_of(browser)
    log_in(browser, key_of(store, Scope.READ).secret)
    assert session_of(browser) != before
    assert (store.sessions.find(before), browser.get("/v1/keys/current").json()["scope"]) == (None, "read")


def test_a_display_s_link_is_printed_as_a_code_logs_one_in_once_and_no_other_secret_is_a_link(browser, store):
    key = key_of(store, Scope.READ, display=True)
    link = store.sessions.invite(key.id)
    assert "Log this display in" in browser.get(f"/login/{link}").text  # and a program that only looks uses nothing up
    fields = {"link": link, "next": "/?kiosk"}
    answer = browser.post("/login", data=fields, headers={"Origin": ORIGIN})
    assert (answer.status_code, answer.headers["Location"]) == (303, "/?kiosk")
    assert "Max-Age=34560000" in answer.headers["Set-Cookie"]
    again = browser.post("/login", data=fields, headers={"Origin": ORIGIN})
    assert again.status_code == 401
    assert "This link was used already" in again.text
    browser.headers["Cookie"] = answer.headers["Set-Cookie"].partition(";")[0]
    assert browser.get("/v1/keys/current").json()["key_id"] == key.id
    store.keys.revoke(key.id)
    assert browser.get("/?kiosk").headers["Location"] == "/login?next=%2F%3Fkiosk&ended=true"
    key = key_of(store, Scope.READ, display=True)
    link = store.sessions.invite(key.id)
    for secret in (key.secret, store.sessions.open(hash_of(key.secret), lasting=True)):
        assert browser.post("/login", data={"link": secret}, headers={"Origin": ORIGIN}).status_code == 401
    for secret in (link, hash_of_link(link)):
        assert store.sessions.find(secret) is None
    command = ["key", "create", "--name", "wall", "--scope", "read", "--data", str(store.files.folder)]
    shown = CliRunner().invoke(main, [*command, "--display", "--url", "https://calibration.mill.example/"])
    link = re.search(r"https://calibration\.mill\.example/login/([\w-]+)\n", shown.stderr)[1]
    assert "▀▀▀▀▀▀▀" in shown.stderr
    secret = re.search(r"^sawmill_\S+$", shown.stdout, re.MULTILINE)[0]
    assert secret not in shown.stderr
    assert store.sessions.use_link(link) == hash_of(secret)
    assert "login/" not in CliRunner().invoke(main, command).stderr


def test_a_session_ends_with_what_opened_it(browser, store):
    for end, act in {"revoked": store.keys.revoke, "rotated": store.keys.rotate, "token changed": None}.items():
        key = key_of(store, Scope.ADMIN)
        log_in(browser, TOKEN if act is None else key.secret)
        assert browser.get("/").status_code == 200
        if act is None:
            browser.app = create_app(ServiceSettings(token=TOKEN[::-1]), store, print)
        else:
            act(key.id)
        assert browser.get("/").status_code == 303, end


@pytest.mark.parametrize("display", [True, False])
def test_a_display_stays_logged_in_and_a_person_does_not(browser, store, display):
    now = datetime.now(UTC)
    clock = [now]
    later = Store.open(store.settings, clock=lambda: clock[0])
    key = key_of(later, Scope.READ, display=display, expires_at=now + timedelta(days=60))
    browser.app = create_app(GUARDED, later, print)
    answer = log_in(browser, key.secret)
    assert ("Max-Age=34560000" in answer.headers["Set-Cookie"]) is display
    clock[0] += timedelta(days=30)
    browser.app = create_app(GUARDED, later, print)  # started again meanwhile
    page = browser.get("/")
    assert page.status_code == (200 if display else 303)
    if display:
        assert page.headers["Set-Cookie"] == answer.headers["Set-Cookie"]
    clock[0] += timedelta(days=30)
    assert browser.get("/").status_code == 303  # the key has expired
    later.close()


def test_without_keys_this_machine_sees_no_login(client):
    assert "Log out" not in client.get("/", headers=HTML).text
    assert client.post("/logout", headers=HTML).headers["Location"] == "/login"
    assert client.get("/", headers={"Cookie": f"{SESSION_COOKIE}=ended"}).status_code == 200
