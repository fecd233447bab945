"""The answers of `/calibrate` are sent once, and again by who comes back to them."""

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]


def test_the_button_sends_once_and_again_after_going_back(site):
    page = site.open("/calibrate?scan=example")
    button = page.get_by_role("main").get_by_role("button", name="Calibrate")
    assert button.evaluate("button => { button.click(); return button.disabled; }")
    page.wait_for_url("**/calibrate?calibration=*")
    page.go_back()
    expect(button).to_be_enabled()
