"""What holds for every page: it fits, a glove hits it, axe-core finds nothing, it prints bare, its scripts run."""

import re

import mill_states
import pytest
from missing_parts import first_by_day
from page_checks import LARGEST_PAGE_BYTES, axe_findings, overflowing, page_bytes, shot, small_targets
from playwright.sync_api import Page

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("seeded")]

PAGES = (
    *("/login", "/nothing/here", "/problems/phantom-not-seen", "/", "/?kiosk", "/calibrate?scanner=example", "/logs"),
    *("/calibrate?inspection=example", "/calibrate?calibration=example", "/scans", "/scans/example", "/logs/example"),
    *("/calibrations/example/report", "/scanners/example", "/scanners/example/history", "/scanners/new", "/phantoms"),
    *("/scanners/example/compare?first=example&second=example", "/phantoms/new", "/phantoms/l-shape", "/jobs"),
    *("/system", "/audit", "/system/webhooks", "/retention", "/help", "/help/look-up/settings", "/help?search=queue"),
    *("/fixed-pairs", "/fixed-pairs/example-pairs", "/pair-logs/example-log"),
)
# The widths that each page is looked at in, the first when it is opened; in which colours and language; and the rules
# of axe-core, of which none stands for all. Its other rules see neither colours nor words.
LOOKS = [((390, 800, 1280, 1920), "light", "en", ()), ((390,), "dark", "fi", ("color-contrast", "html-lang-valid"))]
WIDTHS = LOOKS[0][0]
# What a technician does every day.
BY_KEYBOARD = ("/", "/scanners/example", *(path for path in PAGES if path.startswith("/calibrate?")))
ON_PAPER = """() => [...document.querySelectorAll('header.top, footer.bottom, form, button, .button, .skip')]
    .filter(each => each.checkVisibility()).map(each => each.outerHTML.slice(0, 80))"""
REACHABLE = """() => [...document.querySelectorAll('main a[href], main button, main input, main select, main summary')]
    .filter(each => each.checkVisibility() && !each.disabled && each.type !== 'hidden')
    .filter(each => each.type !== 'radio' || each.checked)"""


def misfits(page: Page, name: str, width: int, colours: str) -> list[str]:
    page.set_viewport_size({"width": width, "height": 844})
    shot(page, f"{name}-{width}-{colours}")
    return [f"{page.url} at {width} px: {each}" for each in (overflowing(page) + small_targets(page))]


@pytest.mark.parametrize("look", first_by_day(1, LOOKS), ids=["light", "dark"])
def test_pages_fit_and_are_accessible(site, look):
    widths, colours, language, rules = look
    errors: list[str] = []
    page = site.open(f"/look?language={language}&theme={colours}&next=/login")
    page.on("pageerror", lambda error: errors.append(f"{page.url}: {error}"))
    for path in PAGES:
        name = re.sub(r"\W+", "-", path).strip("-") or "today"
        page.set_viewport_size({"width": widths[0], "height": 844})
        page.goto(path)
        page.wait_for_load_state("load")
        errors += [f"{path} in {colours}: {each}" for each in axe_findings(page, *rules)]
        errors += [each for width in widths for each in misfits(page, name, width, colours)]
        page.emulate_media(media="print")
        errors += [f"{path} prints {each}" for each in page.evaluate(ON_PAPER)]
        page.emulate_media(media="screen")
    assert not errors


@pytest.mark.nightly
@pytest.mark.parametrize(("colours", "language"), [("light", "en"), ("light", "fi"), ("dark", "en"), ("dark", "fi")])
def test_no_state_of_a_page_scrolls_sideways(site, store, worker, colours, language):
    """With SAWMILL_SCREENSHOTS it is the walk that photographs every page, state and language."""
    found: list[str] = []
    page = site.open(f"/look?language={language}&theme={colours}&next=/login")
    for name, path in mill_states.fill(store, worker).items():
        assert page.goto(path).ok or name == "nothing", path
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 844})
            shot(page, f"{name}-{width}-{language}-{colours}")
            found += [f"{page.url} at {width} px: {each}" for each in overflowing(page)]
    assert not found


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


def test_a_technician_s_pages_are_worked_by_keyboard_and_all_pages_are_small(site):
    page = site.open("/")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.getAttribute('href')") == "#content"
    missed = {}
    for path in BY_KEYBOARD:
        page.goto(path)
        missed[path] = not_reached(page)
    assert not any(missed.values()), missed
    sizes = {path: page_bytes(page, path) for path in PAGES}
    assert {path: size for path, size in sizes.items() if size > LARGEST_PAGE_BYTES} == {}


def test_the_report_prints_on_two_pages_of_a4_and_fits_a_phone(site):
    page = site.open("/calibrations/example/report")
    assert len(page.content()) < 900_000
    # Without headers and footers of the browser's own: the page brings its own. Finnish words are longer.
    for language in ("fi", "en"):
        page.goto(f"/calibrations/example/report?language={language}")
        pdf = page.pdf(prefer_css_page_size=True)
        assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 2
    width, height = (float(number) for number in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf).groups())
    assert (width, height) == pytest.approx((595, 842), abs=1.0)  # 210 x 297 mm, in points
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
