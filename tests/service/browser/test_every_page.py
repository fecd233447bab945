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
LOOKS = [(390, "light", "en"), (800, "dark", "fi"), (1280, "light", "fi")]


def look_at(page: Page, name: str, path: str, width: int, colours: str) -> list[str]:
    """Open a page in a window of this width; what is wrong with it."""
    page.set_viewport_size({"width": width, "height": 844})
    page.goto(path)
    page.wait_for_load_state("load")
    shot(page, f"{name}-{width}-{colours}")
    found = overflowing(page) + small_targets(page)
    return [f"{path} at {width} px: {each}" for each in found]


@pytest.mark.parametrize(("width", "colours", "language"), LOOKS)
def test_pages_fit_and_are_accessible(site, width, colours, language):
    errors: list[str] = []
    page = site.open(f"/look?language={language}&theme={colours}&next=/login")
    page.on("pageerror", lambda error: errors.append(f"{page.url}: {error}"))
    for name, path in PAGES.items():
        errors += look_at(page, name, path, width, colours)
        errors += [f"{path} in {colours}: {each}" for each in axe_findings(page)]
    assert not errors


def test_pages_are_small(site):
    page = site.open("/login")
    sizes = {path: page_bytes(page, path) for path in PAGES.values()}
    assert {path: size for path, size in sizes.items() if size > LARGEST_PAGE_BYTES} == {}
