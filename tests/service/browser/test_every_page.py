"""What holds for every page: it fits, a glove hits it, axe-core finds nothing, it is small, its scripts run."""

import pytest
from page_checks import LARGEST_PAGE_BYTES, axe_findings, overflowing, page_bytes, shot, small_targets
from playwright.sync_api import Page

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

PAGES = {
    "login": "/login",
    "problem": "/nothing/here",
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
    "new-scanner": "/scanners/new",
    "phantoms": "/phantoms",
    "new-phantom": "/phantoms/new",
    "phantom": "/phantoms/l-shape",
    "jobs": "/jobs",
    "system": "/system",
}
# axe-core takes half a second a page, so it looks at each once in every colour.
LOOKS = [(390, "light", "en", True), (800, "light", "fi", False), (1280, "dark", "fi", True)]
# What a technician does every day.
BY_KEYBOARD = ("today", "scanner", "calibrate", "calibrate-questions", "calibrate-result")
REACHABLE = """() => [...document.querySelectorAll('main a[href], main button, main input, main select, main summary')]
    .filter(each => each.checkVisibility() && !each.disabled && each.type !== 'hidden')
    .filter(each => each.type !== 'radio' || each.checked)"""


def look_at(page: Page, name: str, path: str, width: int, colours: str) -> list[str]:
    """Open a page in a window of this width; what is wrong with it."""
    page.set_viewport_size({"width": width, "height": 844})
    page.goto(path)
    page.wait_for_load_state("load")
    shot(page, f"{name}-{width}-{colours}")
    found = overflowing(page) + small_targets(page)
    return [f"{path} at {width} px: {each}" for each in found]


@pytest.mark.parametrize(("width", "colours", "language", "axe"), LOOKS)
def test_pages_fit_and_are_accessible(site, width, colours, language, axe):
    errors: list[str] = []
    page = site.open(f"/look?language={language}&theme={colours}&next=/login")
    page.on("pageerror", lambda error: errors.append(f"{page.url}: {error}"))
    for name, path in PAGES.items():
        errors += look_at(page, name, path, width, colours)
        if axe:
            errors += [f"{path} in {colours}: {each}" for each in axe_findings(page)]
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
