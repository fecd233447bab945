"""The technician's buttons, clicked."""

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from sawmill_service.settings import ServiceSettings
from sawmill_worker.contracts.calibrations import CalibrationAsk
from sawmill_worker.storage.store import Store

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
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
def test_where_there_is_a_token_the_browser_s_password_opens_pages_and_buttons(site, store, newer):
    page = site.open("/docs", http_credentials={"username": "operator", "password": TOKEN})
    expect(page.get_by_role("heading", name="Sawmill calibration")).to_be_visible()
    assert page.evaluate("fetch('/v1/scanners').then(answer => answer.status)") == 200
    page.goto("/")
    page.get_by_role("button", name="Accept this calibration").click()
    expect(page.locator("body")).to_contain_text("History")
    assert store.scanners.get("example").active_calibration_id == newer
