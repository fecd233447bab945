"""Documents of the repository as HTML: each file is rendered once in a process, and nothing else is known.

The folder `documents` of this package mirrors the repository by symbolic links, so links in pages resolve as there.
"""

import os
import posixpath
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.renderer import RendererHTML
from markdown_it.token import Token
from markdown_it.utils import EnvType, OptionsDict
from markupsafe import Markup

from sawmill_service.pages.frame.languages import ENGLISH, LANGUAGES

HELP = "/help"
_ROOT = Path(__file__).parents[2] / "documents"
_SHELVES, _INDEX = "docs/", "docs/README."
_OF_SHELVES = {".md", ".png", ".svg"}
# Files of the repository that have an address of their own.
_ELSEWHERE = {"openapi/openapi.json": "/openapi.json"}


@dataclass(frozen=True)
class Section:
    """Heading of a document with the text below it, as plain text."""

    anchor: str
    heading: str
    text: str


@dataclass(frozen=True)
class Document:
    """Document in one language."""

    path: str  # path below /help; empty for the list of all documents
    language: str  # key of `LANGUAGES`
    title: str  # its first heading
    html: Markup
    sections: Sequence[Section]  # its headings with their texts
    others: Mapping[str, str]  # addresses of the document in other languages, by language


def find_document(path: str, language: str) -> Document | None:
    """Return the document at a path below /help in a language, or else in the language that it has; None without one.

    The paths of a document in two languages end with `.en` and `.fi` where the language does not matter.
    """
    versions = _documents().get(path, {})
    name = versions.get(language) or next(iter(versions.values()), None)
    return None if name is None else _document(name)


def all_documents(language: str, folder: str | None = None) -> Iterator[Document]:
    """Yield every document, or all of a folder, once, in a language where it is in several; no lists of folders."""
    for path, versions in _documents().items():
        name = versions.get(language) or next(iter(versions.values()))
        wanted = name.endswith(".md") and not path.endswith(tuple(f".{each}" for each in LANGUAGES))
        if wanted and folder in {None, posixpath.dirname(path)}:
            yield _document(name)


def neighbours(document: Document, language: str) -> list[Document]:
    """Return the documents in the same folder, the document included."""
    folder = posixpath.dirname(document.path)
    return list(all_documents(language, folder)) if folder else []


@cache
def _tree() -> Mapping[str, Path]:
    """Return the files and folders that are served, by their path in the repository."""
    found: dict[str, Path] = {}
    for place, folders, files in os.walk(_ROOT, followlinks=True):
        folders[:] = sorted(each for each in folders if each != "__pycache__")
        for name in [*folders, *sorted(files)]:
            path = Path(place, name)
            inside = path.relative_to(_ROOT).as_posix()
            if not path.exists():  # a link of the sources, where only the package was copied
                continue
            if not inside.startswith(_SHELVES) or path.is_dir() or path.suffix in _OF_SHELVES:
                found[inside] = path
    return found


@cache
def _documents() -> Mapping[str, Mapping[str, str]]:
    """Return the names of documents and folders by path below /help and by language."""
    found: dict[str, dict[str, str]] = {}
    for name, file in _tree().items():
        if file.suffix == ".md" or file.is_dir():
            found.setdefault(_path(name), {})[_language(name)] = name
    for path, versions in [*found.items()]:
        if len(versions) > 1:
            found |= {f"{path}.{language}": {language: name} for language, name in versions.items()}
    return found


@cache
def files_by_path() -> Mapping[str, Path]:
    """Return the pictures and examples by their paths below /help."""
    return {_path(name): path.resolve() for name, path in _tree().items() if path.suffix != ".md" and path.is_file()}


def _path(name: str) -> str:
    """Return the path below /help of a file or folder of the repository: without its shelves' folder and its ending."""
    if name == "docs" or name.startswith(_INDEX):  # the folder first, so that the index takes its place
        return ""
    return re.sub(rf"(\.(?:{'|'.join(LANGUAGES)}))?\.md$", "", name.removeprefix(_SHELVES))


def _language(name: str) -> str:
    return next((each for each in LANGUAGES if name.endswith(f".{each}.md")), ENGLISH)


@cache
def _document(name: str) -> Document:
    file = _tree()[name]
    # A parser builds its table of rules at its first use; a second thread that shares it could read half of the table.
    markdown = MarkdownIt("commonmark", {"html": True}, renderer_cls=_Renderer).enable("table")
    tokens = markdown.parse(_listed(name) if file.is_dir() else file.read_text(encoding="utf-8"))
    sections = list(_sections(tokens))
    for at, token in enumerate(tokens):
        _lead(name, token.children or [])
        if "right" in str(token.attrs.pop("style", "")):
            token.attrs["class"] = "figure"
        if token.type == "th_open" and not tokens[at + 1].content:  # an empty head of a column is none
            token.tag = tokens[at + 2].tag = "td"
    path, language = _path(name), _language(name)
    return Document(
        path=path,
        language=language,
        title=sections[0].heading if sections else name,
        html=Markup(markdown.renderer.render(tokens, markdown.options, {})),  # noqa: S704 - of our own pages
        sections=sections,
        others={other: f"{HELP}/{path}.{other}" for other in _documents()[path] if other != language},
    )


def _listed(folder: str) -> str:
    """Return a document that lists a folder's files."""
    files = (each for each in _tree() if posixpath.dirname(each) == folder)
    return "\n".join([f"# {Path(folder).name}\n", *(f"- [{Path(each).name}]({Path(each).name})" for each in files)])


def _sections(tokens: Sequence[Token]) -> Iterator[Section]:
    """Yield the sections; each heading gets its anchor as GitHub writes it."""
    seen: Counter[str] = Counter()
    starts = [at for at, token in enumerate(tokens) if token.type == "heading_open"]
    for start, end in pairwise([*starts, len(tokens)]):
        heading = _plain(tokens[start + 1])
        slug = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        anchor = f"{slug}-{seen[slug]}" if seen[slug] else slug
        seen[slug] += 1
        tokens[start].attrSet("id", anchor)
        yield Section(anchor, heading, " ".join(" ".join(map(_plain, tokens[start + 2 : end])).split()))


def _plain(token: Token) -> str:
    """Return a token's text without marks."""
    if token.children is None:
        return token.content if token.type in {"fence", "code_block"} else ""
    return "".join(
        " " if each.type == "softbreak" else each.content for each in token.children if "html" not in each.type
    )


def _lead(name: str, tokens: Sequence[Token]) -> None:
    """Let the links and pictures of a document lead to where the service has them; a link elsewhere becomes text.

    A link whose text is a file's name gets the title of that document.
    """
    opened: list[Token] = []
    for at, token in enumerate(tokens):
        if token.type == "link_open":
            link, text = str(token.attrs["href"]), tokens[at + 1]
            address = _address(name, link)
            opened.append(token)
            token.tag, token.attrs = ("span", {}) if address is None else ("a", {"href": address})
            if text.content == posixpath.basename(link.partition("#")[0]) and text.content.endswith(".md"):
                text.content = _title(_target(name, link)) or text.content
        elif token.type == "link_close":
            token.tag = opened.pop().tag
        elif token.type == "image":
            token.attrs["src"] = _address(name, str(token.attrs["src"])) or ""


def _target(name: str, link: str) -> str:
    """Return the path in the repository to which a link of a document leads."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(name), unquote(link.partition("#")[0])))


def _title(name: str) -> str:
    """Return the first heading of a document, without marks; empty without the document."""
    file = _tree().get(name)
    return "" if file is None else file.read_text(encoding="utf-8").partition("\n")[0].strip("# ").replace("`", "")


def _address(name: str, link: str) -> str | None:
    """Return the address to which a link of a document leads; None where the service does not have its target."""
    if urlsplit(link).scheme or link.startswith(("/", "#")):
        return link
    target, anchor = _target(name, link), link.partition("#")[2]
    if target in _ELSEWHERE:
        return _ELSEWHERE[target]
    if target not in _tree():
        return None
    path = _path(target)
    if path == _path(name) or _language(target) != ENGLISH:  # this language, whatever the reader's
        path += f".{_language(target)}"
    return f"{HELP}/{path}".rstrip("/") + (f"#{anchor}" if anchor else "")


class _Renderer(RendererHTML):
    """Renderer whose wide blocks scroll inside their box; comments vanish, and other HTML is shown as text."""

    def table_open(self, *_: object) -> str:
        return '<div class="scrolls" tabindex="0"><table>\n'

    def table_close(self, *_: object) -> str:
        return "</table></div>\n"

    def fence(self, tokens: Sequence[Token], idx: int, options: OptionsDict, env: EnvType) -> str:  # noqa: ARG002 - as called
        return f'<pre tabindex="0"><code>{escapeHtml(tokens[idx].content)}</code></pre>\n'

    def html_inline(self, tokens: Sequence[Token], idx: int, options: OptionsDict, env: EnvType) -> str:  # noqa: ARG002 - as called
        content = tokens[idx].content
        return "" if content.startswith("<!--") else escapeHtml(content)

    html_block = html_inline
