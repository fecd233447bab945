"""Every page of a bad day in Finnish: what a reader sees without opening a thing has no English."""

import re
from html.parser import HTMLParser

import mill_states

ENGLISH = re.compile(r"\b(?:the|of|and|with|was|is|not|by|for|from|at|to be)\b")
# Texts of people, which stay as they were typed, and the links to the other language.
TYPED = re.compile(r"line-4_2026\S*|Sorting line 4, log scanner behind the debarker|the cross of the hall|English")
SPOKEN = ("alt", "aria-label", "placeholder", "title")
VOID = {"area", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
# Pages whose subject is the API, its codes or its values.
TECHNICAL = {"problems", "problem", "audit", "webhooks"}


class ShownTexts(HTMLParser):
    """Texts of a page that are neither folded nor code, each with the language that the page declares for it."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self._open: list[tuple[str, str | None]] = []
        self.shown: list[tuple[str | None, str]] = []
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if tag not in VOID:
            self._open.append((tag, values.get("lang")))
        for name in SPOKEN:
            self.handle_data(values.get(name) or "")

    def handle_endtag(self, tag):
        while self._open and self._open.pop()[0] != tag:
            pass

    def handle_data(self, data):
        tags = {tag for tag, _ in self._open}
        if data.strip() and not tags & {"script", "style", "code", "datalist"} and "details" not in tags:
            self.shown.append((next((lang for _, lang in reversed(self._open) if lang), None), data.strip()))


def is_english(language: str | None, text: str) -> bool:
    return bool(ENGLISH.search(text)) or (language == "en" and re.search("[a-z]{3}", text) is not None)


def test_pages_of_a_bad_day_are_finnish_without_english_in_sight(seeded, store, worker):
    found = []
    for name, path in mill_states.fill(store, worker, "fi").items():
        page = seeded.get(path, headers={"Accept": "text/html", "Accept-Language": "fi"}).text
        if name not in TECHNICAL:
            texts = [(language, TYPED.sub("", text)) for language, text in ShownTexts(page).shown]
            found += [f"{name}: {text}" for language, text in texts if is_english(language, text)]
    assert found == []
