"""What holds for every page: it fits, a glove hits it, axe-core finds nothing, it is small, its scripts run."""

import pytest
from page_checks import LARGEST_PAGE_BYTES, axe_findings, overflowing, page_bytes, shot, small_targets
from playwright.sync_api import Page

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

PAGES = {
    "login": "/login",
    "problem": "/nothing/here",
    "failure": "/problems/phantom-not-seen",
    "today": "/",
    "calibrate": "/calibrate?scanner=example",
    "calibrate-questions": "/calibrate?inspection=example",
    "calibrate-result": "/calibrate?calibration=example",
    "scans": "/scans",
    "scan": "/scans/example",
    "logs": "/logs",
    "log": "/logs/example",
    "report": "/calibrations/example/report",
    "scanner": "/scanners/example",
    "history": "/scanners/example/history",
    "new-scanner": "/scanners/new",
    "phantoms": "/phantoms",
    "new-phantom": "/phantoms/new",
    "phantom": "/phantoms/l-shape",
    "jobs": "/jobs",
    "system": "/system",
    "webhooks": "/system/webhooks",
    "retention": "/retention",
}
# The widths that each page is looked at in, the first when it is opened; and in which colours and language.
LOOKS = [((390,), "light", "en"), ((1280, 800), "dark", "fi")]
# What a technician does every day.
BY_KEYBOARD = ("today", "scanner", "calibrate", "calibrate-questions", "calibrate-result")
REACHABLE = """() => [...document.querySelectorAll('main a[href], main button, main input, main select, main summary')]
    .filter(each => each.checkVisibility() && !each.disabled && each.type !== 'hidden')
    .filter(each => each.type !== 'radio' || each.checked)"""


def misfits(page: Page, name: str, width: int, colours: str) -> list[str]:
    """What is wrong with an open page in a window of this width."""
    page.set_viewport_size({"width": width, "height": 844})
    shot(page, f"{name}-{width}-{colours}")
    found = overflowing(page) + small_targets(page)
    return [f"{page.url} at {width} px: {each}" for each in found]


@pytest.mark.parametrize(("widths", "colours", "language"), LOOKS, ids=str)
def test_pages_fit_and_are_accessible(site, widths, colours, language):
    errors: list[str] = []
    page = site.open(f"/look?language={language}&theme={colours}&next=/login")
    page.on("pageerror", lambda error: errors.append(f"{page.url}: {error}"))
    for name, path in PAGES.items():
        page.set_viewport_size({"width": widths[0], "height": 844})
        page.goto(path)
        page.wait_for_load_state("load")
        errors += [f"{path} in {colours}: {each}" for each in axe_findings(page)]
        errors += [each for width in widths for each in misfits(page, name, width, colours)]
    assert not errors


def not_reached(page: Page) -> list[str]:
    """What of a page the tabulator key does not reach, or reaches without a mark that can be seen."""
    page.evaluate(f"window.unseen = new Set(({REACHABLE})())")
    for _ in range(page.evaluate("unseen.size + 40")):
        page.keyboard.press("Tab")
        page.evaluate("""() => {
            const focused = document.activeElement, style = getComputedStyle(focused);
            if (style.outlineStyle !== 'none' && style.outlineWidth !== '0px') unseen.delete(focused);
        }""")
    return page.evaluate("[...unseen].map(each => each.outerHTML.slice(0, 100))")


def test_a_technician_s_pages_are_worked_by_keyboard(site):
    page = site.open("/")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.getAttribute('href')") == "#content"
    missed = {}
    for name in BY_KEYBOARD:
        page.goto(PAGES[name])
        missed[name] = not_reached(page)
    assert not any(missed.values()), missed


def test_pages_are_small(site):
    page = site.open("/login")
    sizes = {path: page_bytes(page, path) for path in PAGES.values()}
    assert {path: size for path, size in sizes.items() if size > LARGEST_PAGE_BYTES} == {}
