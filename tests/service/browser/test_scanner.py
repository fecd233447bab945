"""A scanner's page in a browser: accept and roll back, the slider, the chart, schedules and settings."""

import re

import pytest
from page_checks import overflowing, shot
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]
PAGE = "/scanners/example"


def split(page: Page) -> float:
    """Where the picture after begins, in per cent from the left, as it is clipped."""
    clip = page.locator(".over").evaluate("image => getComputedStyle(image).clipPath")
    return float(re.search(r"([\d.]+)%\)$", clip)[1])


def test_a_calibration_is_compared_accepted_and_rolled_back(site, store, newer):
    page = site.open(PAGE, viewport={"width": 390, "height": 844})
    page.get_by_label("How much of the picture before is shown").focus()
    assert split(page) == 50
    page.keyboard.press("ArrowLeft")
    assert split(page) == 49
    page.keyboard.press("Home")
    assert split(page) == 0
    box = page.locator(".stack").bounding_box()
    page.mouse.move(box["x"] + 10, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 60)
    page.mouse.up()
    assert (split(page), overflowing(page)) == (pytest.approx(75, abs=1), [])
    shot(page, "scanner-story-390")

    # Nothing has compared it with the one in use: accepting is not the next step, and asks once.
    sure = page.get_by_role("button", name="Yes, accept it")
    expect(sure).to_be_hidden()
    page.get_by_text("Accept all the same", exact=True).click()
    sure.click()
    expect(page.get_by_text("This is the active calibration")).to_be_visible()
    assert store.scanners.get("example").active_calibration_id == newer

    # Rolling back asks once, and says what will happen.
    really = page.get_by_role("button", name="Yes, roll back")
    expect(really).to_be_hidden()
    page.get_by_text("Roll back", exact=True).click()
    expect(page.get_by_text("use this calibration again. Nothing is deleted")).to_be_visible()
    page.get_by_label("Why").fill("the turntable was straightened")
    really.click()
    # What was just rejected is not offered again: the way back is in the history.
    expect(page.get_by_role("heading", name="Calibration in use")).to_be_visible()
    expect(page.get_by_text("Accept all the same", exact=True)).to_have_count(0)
    expect(page.locator(".entries li").first).to_contain_text("the turntable was straightened")
    assert store.scanners.get("example").active_calibration_id == "example"


def test_values_schedules_and_settings(site, store):
    page = site.open(PAGE, viewport={"width": 800, "height": 900}, timezone_id="Asia/Tokyo")
    chart, readout = page.get_by_role("slider", name="Measurements"), page.locator("#readout")
    page.get_by_role("link", name="2 years").focus()
    page.keyboard.press("Tab")
    expect(chart).to_be_focused()
    expect(readout).to_contain_text("drift check · Rays moved 0.010")
    page.keyboard.press("ArrowLeft")
    expect(readout).to_contain_text("calibration · Rays moved not known")
    assert "calibration" in chart.get_attribute("aria-valuetext")
    page.locator(".values use").nth(0).hover(force=True)
    expect(readout).to_contain_text("Rays moved")

    page.get_by_text("Add a schedule").click()
    page.get_by_label("Days", exact=True).select_option("Every Monday")
    page.get_by_label("Time of day").fill("04:15")
    # That of the browser, until another is chosen.
    expect(page.get_by_label("Time zone of the mill")).to_have_value("Asia/Tokyo")
    page.get_by_label("Time zone of the mill").fill("Europe/Helsinki")
    page.get_by_role("button", name="Add this schedule").click()
    mine = page.locator(".entries li").filter(has_text="Every Monday at 04:15, Europe/Helsinki")
    expect(mine).to_be_visible()
    mine.get_by_role("button", name="Delete this schedule").click()
    expect(page.get_by_role("heading", name="Schedules")).to_be_visible()
    expect(page.locator(".entries li").filter(has_text="Every Monday")).to_have_count(0)

    page.get_by_text("Change the settings").click()
    page.get_by_label("Name").fill("Line 7")
    page.get_by_label("Source to turning axis").fill("-859")
    page.get_by_role("button", name="Save the settings").click()
    expect(page.get_by_text("must be more than 0, not -859")).to_be_visible()
    expect(page.get_by_label("Name")).to_have_value("Line 7")
    page.get_by_label("Source to turning axis").fill("860")
    page.get_by_role("button", name="Save the settings").click()
    expect(page.get_by_role("heading", name="Line 7")).to_be_visible()
    assert store.scanners.get("example").constants.source_to_cor_mm == 860.0
