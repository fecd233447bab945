"""The languages of the pages: gettext catalogues, and the choice of a language for a browser."""

import gettext
import io
from enum import StrEnum
from functools import cache
from pathlib import Path

from babel import Locale, negotiate_locale
from babel.messages.catalog import Catalog
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po

_CATALOGUES = Path(__file__).parents[2] / "locale"
ENGLISH = "en"


class Language(StrEnum):
    """Languages of the report."""

    ENGLISH = ENGLISH
    FINNISH = "fi"


# Names of the languages in the languages themselves, so that readers recognise their own.
LANGUAGES = {ENGLISH: "English", "fi": "Suomi"}
# Locales whose dates, hours and decimals are used for a language.
_REGIONS = {ENGLISH: "en_GB"}


def marked(text: str) -> str:
    """Mark a text for the catalogues where it is written; it is translated where it is shown."""
    return text


def catalogue(language: str) -> Catalog:
    """Read the translations into a language other than English."""
    with (_CATALOGUES / language / "LC_MESSAGES" / "sawmill.po").open("rb") as file:
        return read_po(file, locale=language)


@cache
def texts(language: str) -> gettext.NullTranslations:
    """Return the catalogue of a language; English needs none, because the pages are written in it."""
    if language == ENGLISH:
        return gettext.NullTranslations()
    compiled = io.BytesIO()
    write_mo(compiled, catalogue(language))
    compiled.seek(0)
    return gettext.GNUTranslations(compiled)


def locale_of(language: str) -> Locale:
    """Return the locale by which a language writes dates and numbers."""
    return Locale.parse(_REGIONS.get(language, language))


def preferred_language(chosen: str, accepted: str) -> str:
    """Choose the language of the answer."""
    if chosen in LANGUAGES:
        return chosen
    by_weight = sorted((_weighed(part) for part in accepted.split(",")[:20]), reverse=True)
    return negotiate_locale([name for weight, name in by_weight if weight > 0.0], LANGUAGES, sep="-") or ENGLISH


def _weighed(part: str) -> tuple[float, str]:
    name, _, parameter = part.partition(";")
    try:
        weight = float(parameter.strip().removeprefix("q=") or 1.0)
    except ValueError:  # no weight of the standard: the language is not accepted
        weight = 0.0
    return weight, name.strip().lower()
