"""The token: what needs it, how it is brought, and that it is never shown."""

import re
from base64 import b64encode

import pytest
from pydantic import ValidationError

from sawmill_service.app import create_app
from sawmill_service.settings import ServiceSettings

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
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
