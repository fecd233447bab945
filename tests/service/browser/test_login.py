"""A login in a browser: what it opens, and until when."""

import pytest
from playwright.sync_api import Page, Route, expect

from sawmill_contracts.calibrations import CalibrationRequest
from sawmill_platform.contracts.keys import KeyRequest, Scope
from sawmill_service.settings import ServiceSettings

TOKEN = "Zm9yIHRlc3RzIGFsb25lLCBub3QgYSBzZWNyZXQ"  # noqa: S105 - for tests alone
SCANNER_ID = {"name": "scanner_id", "in": "path", "required": True, "schema": {"type": "string"}}
NO_ANSWERS = {"default": {"description": "A problem."}}
DELETE = {"operationId": "delete_scanner", "tags": ["scanners"], "parameters": [SCANNER_ID], "responses": NO_ANSWERS}
ONE_OPERATION = {"openapi": "3.1.0", "info": {"title": "Sawmill calibration", "version": "0"}}
ONE_OPERATION |= {"paths": {"/v1/scanners/{scanner_id}": {"delete": DELETE}}}
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


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
    assert (page.evaluate(unmarked)["code"], page.evaluate("document.cookie")) == ("csrf", "")
    page.goto("/scanners/example")
    accept_all_the_same(page)
    expect(page.get_by_text("Accept all the same", exact=True)).to_have_count(0)
    assert store.scanners.get("example").active_calibration_id == newer
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_label("Key", exact=True)).to_be_visible()
    page.go_back()
    expect(page.get_by_label("Key", exact=True)).to_be_visible()


@pytest.mark.parametrize("settings", [ServiceSettings(token=TOKEN)], ids=["with-a-token"])
def test_two_people_see_one_result_and_an_ended_session_loses_no_answer(site, store, worker, newer):
    anna, bert = (store.keys.create(KeyRequest(name=name, scope=Scope.ACTIVATE)) for name in ("Anna", "Bert"))
    result = f"/calibrate?calibration={newer}"
    hers, his = (site.open(result, locale=locale) for locale in ("en-GB", "fi-FI"))
    log_in(hers, "Key", anna.secret)
    # His line is slow, and he is about to discard it when his session ends: nothing is changed, his reason is there.
    his.route("**/kept_answers.js", slow_line, times=1)
    log_in(his, "Avain", bert.secret)
    his.get_by_text("Hylkää", exact=True).click()
    his.get_by_label("Muu syy:").check()
    his.get_by_label("Muu syy", exact=True).fill("tukki heilui")
    store.keys.revoke(bert.id)
    his.get_by_role("button", name="Kyllä, hylkää").click()
    expect(his.get_by_role("status")).to_have_text(
        "Istuntosi on päättynyt; mitään ei muutettu. Kirjaudu ja jatka tästä."
    )
    log_in(his, "Avain", TOKEN)
    expect(his.get_by_label("Muu syy", exact=True)).to_have_value("tukki heilui")
    expect(his.get_by_label("Muu syy:")).to_be_checked()
    # She accepts it: his page follows, and names her. A second click would have changed nothing.
    accept_all_the_same(hers)
    expect(hers.get_by_text("This is the active calibration")).to_be_visible()
    expect(his.get_by_text("Tämä kalibrointi on käytössä")).to_be_visible()
    expect(his.get_by_text("Hyväksyjä: Anna")).to_be_visible()
    hers.goto("/scanners/example")
    expect(hers.get_by_role("heading", name="Calibration in use")).to_be_visible()
    waiting = store.calibrations.accept(CalibrationRequest(scan_id="example")).id
    worker.finish_calibration()
    hers.reload()
    expect(hers.get_by_text("Accept all the same", exact=True)).to_be_visible()
    store.calibrations.discard(waiting, "by another person")
    expect(hers.get_by_text("Accept all the same", exact=True)).to_have_count(0)
    number = store.events.newest_number()
    store.calibrations.activate(newer, "a second click")
    assert store.events.newest_number() == number
    # A file that is dropped after the session's end is answered in her language, with the way back.
    hers.goto("/calibrate?scanner=example")
    hers.get_by_label("Choose the phantom's scan").set_input_files({"name": "a.h5", "mimeType": "", "buffer": b""})
    expect(hers.get_by_role("alert")).to_have_text("a.h5 is empty. Was the export finished?")
    store.keys.revoke(anna.id)
    hers.get_by_label("Choose the phantom's scan").set_input_files({"name": "a.h5", "mimeType": "", "buffer": b"1"})
    expect(hers.get_by_role("alert")).to_contain_text("Your session has ended; nothing was changed.")
    hers.get_by_role("main").get_by_role("link", name="Log in").click()
    log_in(hers, "Key", TOKEN)
    expect(hers).to_have_url(f"{site.address}/calibrate?scanner=example")


def slow_line(route: Route) -> None:
    route.request.frame.page.wait_for_timeout(1000)
    route.continue_()


def log_in(page: Page, label: str, secret: str) -> None:
    page.get_by_label(label, exact=True).fill(secret)
    page.keyboard.press("Enter")


def accept_all_the_same(page: Page) -> None:
    page.get_by_text("Accept all the same", exact=True).click()
    page.get_by_role("button", name="Yes, accept it").click()
