"""Every page of a bad day in Finnish: what a reader sees without opening a thing has no English."""

import re
from html import unescape

import mill_states

ENGLISH = re.compile(r"\b(?:the|of|and|with|was|is|not|by|for|from|at|to be)\b")
# Texts of people, which stay as they were typed.
TYPED = re.compile(r"line-4_2026\S*|Sorting line 4, log scanner behind the debarker|the cross of the hall")
# Pages whose subject is the API, its codes or its values.
TECHNICAL = {"problems", "problem", "audit", "webhooks"}


def english_in_sight(html: str) -> list[str]:
    """Texts of a page that are English or declared to be, but no code and nothing that is folded."""
    for tag in ("script", "style", "code", "datalist", "details"):
        while (less := re.sub(rf"<{tag}\b(?:(?!<{tag}\b).)*?</{tag}>", " ", html, flags=re.DOTALL)) != html:
            html = less
    declared = [text for _, text in re.findall(r'<(\w+)[^>]* lang="en"[^>]*>(.*?)</\1>', html, re.DOTALL)]
    spoken = re.findall(r'(?:alt|aria-label|placeholder|title)="([^"]*)"', html) + re.split(r"<[^>]*>", html)
    return [text for text in declared if re.search(r"[a-z]{3}", text)] + [
        text for text in spoken if ENGLISH.search(TYPED.sub("", unescape(text)))
    ]


def test_pages_of_a_bad_day_are_finnish_without_english_in_sight(seeded, store, worker):
    finnish = {"Accept": "text/html", "Accept-Language": "fi"}
    pages = {
        name: seeded.get(path, headers=finnish).text for name, path in mill_states.fill(store, worker, "fi").items()
    }
    shown = '<p lang="en">seen</p><p title="by x"><details>of<details>of</details></details>'
    assert english_in_sight(shown) == ["seen", "by x"]
    assert {name: found for name in pages.keys() - TECHNICAL if (found := english_in_sight(pages[name]))} == {}
