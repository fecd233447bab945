"""The texts of the pages into the catalogues: `make texts`.

A text is found in templates (`_`, `ngettext`, `trans`) and in Python (`gettext`, `ngettext`, `marked`, `N_`). One that
is new has no translation yet; one that is gone goes; translations stay where their text does.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from babel.messages.catalog import Catalog, Message
from babel.messages.extract import DEFAULT_KEYWORDS, extract_from_dir
from babel.messages.pofile import read_po, write_po

from sawmill_service.pages.languages import CATALOGUES, ENGLISH, LANGUAGES
from sawmill_worker import contracts

_SERVICE = Path(__file__).parent.parent
# Where texts for people at the mill are written, and below which of them a text is found.
_PLACES = (_SERVICE, Path(contracts.__file__).parent)
_METHODS = [("**/templates/**.html", "jinja2"), ("**.py", "python")]
_OPTIONS = {"**/templates/**.html": {"newstyle_gettext": "true", "trimmed": "false", "trim_blocks": "true"}}
_KEYWORDS = {**DEFAULT_KEYWORDS, "marked": None}
_WIDTH = 120


def found_texts() -> Catalog:
    """Every text of the pages, without translation."""
    catalogue = Catalog(fuzzy=False)
    for place, name, text, comments in _found():
        catalogue.add(text, locations=[(f"{place.name}/{name}", 0)], auto_comments=comments)
    return catalogue


def catalogue_path(language: str) -> Path:
    """Where a language's texts lie."""
    return CATALOGUES / language / "LC_MESSAGES" / "sawmill.po"


def read_catalogue(language: str) -> Catalog:
    """A language's texts as they are stored."""
    with catalogue_path(language).open("rb") as file:
        return read_po(file, locale=language)


def brought_up_to_date(language: str) -> int:
    """Write the texts that there are into a language's catalogue; how many of them lack a translation."""
    catalogue = read_catalogue(language)
    catalogue.update(found_texts(), no_fuzzy_matching=True, update_creation_date=False)
    catalogue.obsolete.clear()
    with catalogue_path(language).open("wb") as file:
        write_po(file, catalogue, width=_WIDTH, omit_header=False, include_lineno=False, sort_output=True)
    return len(untranslated(catalogue))


def untranslated(catalogue: Catalog) -> list[Message]:
    """Texts that lack a translation, or one of its forms."""
    return [message for message in catalogue if message.id and not _is_translated(message.string)]


def _found() -> Iterator[tuple[Path, str, str | tuple[str, ...], list[str]]]:
    for place in _PLACES:
        for name, _, text, comments, _ in extract_from_dir(place, _METHODS, _OPTIONS, keywords=_KEYWORDS):
            yield place, name, text, comments


def _is_translated(forms: str | Sequence[str] | None) -> bool:
    return bool(forms) if isinstance(forms, str) or forms is None else all(forms)


def main() -> None:
    """Bring every catalogue up to date."""
    for language in LANGUAGES.keys() - {ENGLISH}:
        missing = brought_up_to_date(language)
        print(f"{catalogue_path(language)}: {missing} texts lack a translation")  # noqa: T201 - a command's answer


if __name__ == "__main__":
    main()
