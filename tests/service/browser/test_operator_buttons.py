"""The technician's buttons, clicked."""

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from sawmill_service.settings import ServiceSettings
from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.contracts.keys import KeyAsk, Scope
from sawmill_worker.storage.store import Store

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
MINUTE_MS = 60_000
SCANNER_ID = {"name": "scanner_id", "in": "path", "required": True, "schema": {"type": "string"}}
ONE_OPERATION = {
    "openapi": "3.1.0",
    "info": {"title": "Sawmill calibration", "version": "0"},
    "paths": {
        "/v1/scanners/{scanner_id}": {
            "delete": {
                "operationId": "delete_scanner",
                "tags": ["scanners"],
                "parameters": [SCANNER_ID],
                "responses": {"default": {"description": "A problem."}},
            }
        }
    },
}
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


@pytest.fixture
def newer(store: Store, worker) -> str:
    """A calibration that nobody has accepted yet, newer than the active one, which is `example`."""
    identifier = store.calibrations.accept(CalibrationAsk(scan_id="example")).id
    worker.finish_calibration()
    return identifier


def history(page: Page) -> Locator:
    """The history's rows, laid open."""
    page.get_by_text("History").click()
    return page.locator("li")


def entry(calibration_id: str, end: str) -> re.Pattern[str]:
    """A row of the history, with its last words."""
    return re.compile(rf"{calibration_id}.*{end}\s*$", re.DOTALL)


def test_accept_and_roll_back_make_a_calibration_the_active_one(site, store, newer):
    page = site.open()
    page.get_by_role("button", name="Accept this calibration").click()
    expect(page.locator("body")).to_contain_text("History")
    expect(page.get_by_role("button", name="Accept this calibration")).to_have_count(0)
    entries = history(page)
    expect(entries).to_have_text([entry(newer, "active"), entry("example", "Roll back")])
    assert store.scanners.get("example").active_calibration_id == newer

    entries.nth(1).get_by_role("button", name="Roll back").click()
    expect(page.get_by_role("button", name="Accept this calibration")).to_be_visible()
    # The newest activation alone is the active one, though `example` stands in the history twice.
    expected = [entry("example", "active"), entry(newer, "Roll back"), entry("example", "on pass")]
    expect(history(page)).to_have_text(expected)
    assert store.scanners.get("example").active_calibration_id == "example"


@pytest.mark.parametrize("settings", [ServiceSettings(token=TOKEN)], ids=["with-a-token"])
def test_a_login_opens_pages_buttons_and_the_console_until_the_logout(site, store, newer):
    page = site.open("/docs")
    # The console draws one operation: the whole document takes it seconds.
    page.route("**/openapi.json", lambda route: route.fulfill(json=ONE_OPERATION))
    expect(page.get_by_label("Key")).to_be_focused()
    page.keyboard.type("sawmill_wrong")
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("alert")).to_contain_text("This key opens nothing here")
    page.get_by_label("Key").fill(TOKEN)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("heading", name="Sawmill calibration")).to_be_visible()
    # What the console sends bears the session's token, and nothing else that the page sends does.
    page.locator("#operations-scanners-delete_scanner").get_by_role("button").first.click()
    page.get_by_placeholder("scanner_id").fill("nobody")
    page.get_by_role("button", name="Execute").click()
    expect(page.locator(".live-responses-table")).to_contain_text("there is no scanner 'nobody'")
    unmarked = "fetch('/v1/scanners/nobody', {method: 'DELETE'}).then(answer => answer.json())"
    assert page.evaluate(unmarked)["code"] == "csrf"
    assert page.evaluate("document.cookie") == ""
    page.goto("/")
    page.get_by_role("button", name="Accept this calibration").click()
    expect(page.locator("body")).to_contain_text("History")
    assert store.scanners.get("example").active_calibration_id == newer
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_label("Key")).to_be_visible()
    page.go_back()
    expect(page.get_by_label("Key")).to_be_visible()


@pytest.mark.parametrize("settings", [ServiceSettings(token=TOKEN)], ids=["with-a-token"])
def test_a_display_looks_again_each_minute_and_says_when_it_cannot(site, store, newer):
    key = store.keys.create(KeyAsk(name="display", scope=Scope.READ, display=True))
    page = site.open()
    page.clock.install()
    page.get_by_label("Key").fill(key.secret)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_text("History")).to_be_visible()
    expect(page.get_by_role("button")).to_have_text(["Log out"])
    page.wait_for_load_state()  # the script's timer is set
    store.calibrations.activate(newer, "by hand")
    page.clock.run_for(MINUTE_MS)
    expect(page.locator("li")).to_have_count(2)
    expect(page.get_by_role("alert")).to_be_hidden()
    page.context.set_offline(True)
    page.clock.run_for(MINUTE_MS)
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer")
    expect(page.locator("li")).to_have_count(2)
    page.context.set_offline(False)
    page.clock.run_for(MINUTE_MS)
    expect(page.get_by_role("alert")).to_be_hidden()
    store.keys.revoke(key.id)
    page.clock.run_for(MINUTE_MS)
    expect(page.get_by_label("Key")).to_be_visible()
