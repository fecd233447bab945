"""What every page must keep, asked of a page in a real browser."""

import os
import re
from pathlib import Path
from urllib.parse import urlsplit

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

SMALLEST_TARGET_PX = 44
# Without pictures: what a page is made of.
LARGEST_PAGE_BYTES = 300_000
# Links in running text and in tables are as high as their line; so are check boxes, whose label is the target.
SMALL_TARGETS = """least => [...document.querySelectorAll('button, .button, select, summary, nav a, input, .target')]
    .filter(each => each.checkVisibility() && !['hidden', 'checkbox', 'radio', 'range', 'color'].includes(each.type))
    .map(each => [each, each.getBoundingClientRect()])
    .filter(([each, box]) => box.width > 0 && (box.height < least - 0.5 || box.width < least - 0.5))
    .map(([each, box]) => `${each.outerHTML.slice(0, 80)} is ${box.width.toFixed(0)} x ${box.height.toFixed(0)}`)"""
WIDER = """() => [...document.querySelectorAll('main *, header, footer')]
    .filter(each => each.getBoundingClientRect().right > innerWidth + 1 && !each.closest('.scrolls, svg'))
    .map(each => each.outerHTML.slice(0, 80))"""


# What a card or a table within one hides at its edge, though the page itself does not scroll; documents may.
CLIPPED = """() => [...document.querySelectorAll('main .card, main .card .scrolls')]
    .filter(each => each.checkVisibility() && each.scrollWidth > each.clientWidth + 1 && !each.closest('article.card'))
    .map(each => `clipped: ${each.outerHTML.slice(0, 80)}`)"""


def shot(page: Page, name: str) -> None:
    """Keep the whole page as a picture in the folder that SAWMILL_SCREENSHOTS names: it takes a while."""
    if folder := os.environ.get("SAWMILL_SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=True)


def axe_findings(page: Page, *rules: str) -> list[str]:
    """Return what axe-core finds by some of its rules, or by all of them, each with its place."""
    options: dict[str, object] = {"resultTypes": ["violations"]}
    if rules:
        options["runOnly"] = rules
    found = Axe().run(page, context={"exclude": [["#console"]]}, options=options).response["violations"]
    return [f"{each['id']}: {node['html'][:120]}" for each in found for node in each["nodes"]]


def overflowing(page: Page) -> list[str]:
    """What reaches beyond the window's right edge, if the page scrolls sideways, or beyond that of a card."""
    page.wait_for_load_state()
    scrolls = page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth + 1")
    return (page.evaluate(WIDER) if scrolls else []) + page.evaluate(CLIPPED)


def small_targets(page: Page) -> list[str]:
    """Buttons, fields and links of the header that a glove misses, once the page has its styles."""
    page.wait_for_load_state()
    return page.evaluate(SMALL_TARGETS, SMALLEST_TARGET_PX)


def looks_right(page: Page, name: str) -> None:
    """A glove hits it, on a telephone too; `test_every_page` looks at other widths."""
    page.set_viewport_size({"width": 390, "height": 844})
    shot(page, f"{name}-390")
    assert overflowing(page) + small_targets(page) == []


def page_bytes(page: Page, path: str) -> int:
    """Of a page's HTML, styles and scripts, as they are sent; its scripts' imports too."""
    seen: dict[str, int] = {}
    waiting = [path]
    while waiting:
        address = waiting.pop()
        if address in seen:
            continue
        text = page.request.get(address, headers={"Accept": "text/html"}).text()
        seen[address] = len(text.encode())
        named = re.findall(r"""(?:<script[^>]*src=|<link rel="stylesheet" href=)["']([^"']+)""", text)
        named += re.findall(r"""^(?:import|export)\b.*?["'](\.?/[^"']+)["']""", text, re.MULTILINE)
        folder = urlsplit(address).path.rsplit("/", 1)[0]
        waiting += [f"{folder}/{each[2:]}" if each.startswith("./") else each for each in named]
    return sum(seen.values())
