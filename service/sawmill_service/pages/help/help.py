"""Pages of the documents at /help: the list of all, each document, its pictures and examples, and a search."""

import re
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.responses import HTMLResponse
from markupsafe import Markup, escape

from sawmill_platform.contracts.keys import Scope
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import file
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import LANGUAGES
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_service.pages.help.documents import (
    HELP,
    Document,
    Section,
    all_documents,
    files_by_path,
    find_document,
    neighbours,
)

router = Router(include_in_schema=False, reading=Scope.READ)
_PICTURES = {".png": "image/png", ".svg": "image/svg+xml"}
_TEXT = "text/plain; charset=utf-8"


@router.get(HELP)
def help_list(page: ThePage, words: Annotated[str, Query(alias="search", max_length=200)] = "") -> HTMLResponse:
    """List all documents, or what a search finds in them."""
    if words.strip():
        return page.answer("help_search.html", words=words, hits=search(words, page.language))
    return _shown("", page)


@router.get(f"{HELP}/{{path:path}}")
def help_page(path: Annotated[str, Path(max_length=200)], request: Request, page: ThePage) -> Response:
    """Show a document, or return a picture or an example."""
    if found := files_by_path().get(path):
        return file(request, found, _PICTURES.get(found.suffix, _TEXT), save_as=found.name)
    return _shown(path, page)


def _shown(path: str, page: ThePage) -> HTMLResponse:
    document = find_document(path, page.language)
    if document is None:
        absent = f"there is no document {path!r}; {HELP} lists all"
        lost = "this installation has no documents: install the service again, from its wheel"
        raise Refused(404, "unknown-path", absent if path else lost)
    beside = neighbours(document, page.language)
    return page.answer("help.html", document=document, neighbours=beside, words="", names=LANGUAGES)


_MOST_HITS, _MOST_WORDS = 30, 8
_BEFORE, _AFTER = 80, 160  # letters of an excerpt around the first word
# A word of a title says more about a section than one in the heading, and that more than one in the text. Words that
# stand there together, as in `queue-full`, say more than the same words apart.
_OF_TITLE, _OF_HEADING, _OF_PHRASE, _MOST_OF_TEXT = 20, 10, 10, 5
# A reader who searches for words wants to do something; codes and settings are looked up.
_TO_DO, _OF_TO_DO = ("do/", "start/"), 2.0
_LETTERS_A_HIT = 500  # of a text in which one hit counts half


@dataclass(frozen=True)
class Hit:
    """Section that was found, with an excerpt whose words are marked."""

    address: str
    document: Document
    heading: str
    excerpt: Markup
    score: float


def search(words: str, language: str) -> list[Hit]:
    """Find the sections that have all words, or parts of words, in any order; none without a word."""
    wanted = words.casefold().split()[:_MOST_WORDS]
    if not wanted:
        return []
    hits = [
        Hit(
            f"{HELP}/{document.path}".rstrip("/") + f"#{section.anchor}",
            document,
            section.heading,
            _excerpt(section.text, wanted),
            score,
        )
        for document in all_documents(language)
        for section in document.sections
        if (score := _score(document, section, wanted))
    ]
    return sorted(hits, key=attrgetter("score"), reverse=True)[:_MOST_HITS]


def _score(document: Document, section: Section, wanted: list[str]) -> float:
    title, heading, text = (each.casefold() for each in (document.title, section.heading, section.text))
    if not all(word in title or word in heading or word in text for word in wanted):
        return 0.0
    own = sum(_OF_HEADING * (word in heading) + _of_text(text.count(word), len(text)) for word in wanted)
    phrase = _OF_PHRASE * bool(_phrase(wanted).search(f"{heading} {text}"))
    found = own and own + phrase + sum(_OF_TITLE * (word in title) for word in wanted)
    tells_what_to_do = document.path.startswith(_TO_DO) and all(word.isalpha() for word in wanted)
    return found * (_OF_TO_DO if tells_what_to_do else 1.0)


def _of_text(hits: int, letters: int) -> float:
    return _MOST_OF_TEXT * hits / (hits + letters / _LETTERS_A_HIT) if hits else 0.0


def _phrase(wanted: list[str]) -> re.Pattern[str]:
    return re.compile(r"[\s_-]".join(map(re.escape, wanted)), re.IGNORECASE)


def _excerpt(text: str, wanted: list[str]) -> Markup:
    pattern = re.compile(f"({'|'.join(map(re.escape, wanted))})", re.IGNORECASE)
    found = _phrase(wanted).search(text) or pattern.search(text)
    at = found.start() if found else 0
    start = text.rfind(" ", 0, max(0, at - _BEFORE)) + 1
    end = text.find(" ", at + _AFTER)
    parts = pattern.split(text[start:] if end < 0 else text[start:end])
    marked = (Markup("<mark>{}</mark>").format(part) if place % 2 else escape(part) for place, part in enumerate(parts))
    return escape("… " if start else "") + Markup("").join(marked) + escape(" …" if end > 0 else "")
