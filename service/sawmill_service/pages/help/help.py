"""Pages of the documents at /help: the list of all, each document, its pictures and examples, and a search."""

from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.responses import HTMLResponse

from sawmill_platform.contracts.keys import Scope
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import file
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import LANGUAGES
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_service.pages.help.documents import HELP, find_document, find_file, neighbours
from sawmill_service.pages.help.search import search

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
    if found := find_file(path):
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
