"""A login in a browser: what it opens, and until when."""

import pytest
from playwright.sync_api import expect

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
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


@pytest.mark.parametrize("settings", [ServiceSettings(token=TOKEN)], ids=["with-a-token"])
def test_a_login_opens_pages_buttons_and_the_console_until_the_logout(site, store, newer):
    page = site.open("/docs")
    # The console draws one operation: the whole document takes it seconds.
    page.route("**/openapi.json", lambda route: route.fulfill(json=ONE_OPERATION))
    expect(page.get_by_label("Key", exact=True)).to_be_focused()
    page.keyboard.type("sawmill_wrong")
    expect(page.get_by_label("Key", exact=True)).to_have_attribute("type", "password")
    page.get_by_label("Show the key").check()
    expect(page.get_by_label("Key", exact=True)).to_have_attribute("type", "text")
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("alert")).to_contain_text("This key opens nothing here")
    page.get_by_label("Key", exact=True).fill(TOKEN)
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
    page.goto("/scanners/example")
    page.get_by_role("button", name="Accept this calibration").click()
    expect(page.get_by_role("button", name="Accept this calibration")).to_have_count(0)
    assert store.scanners.get("example").active_calibration_id == newer
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_label("Key", exact=True)).to_be_visible()
    page.go_back()
    expect(page.get_by_label("Key", exact=True)).to_be_visible()
