"""The catalogues hold every text of the pages, in each language."""

import pytest
from babel.messages.checkers import checkers

from sawmill_service.pages.catalogues import found_texts, read_catalogue, untranslated
from sawmill_service.pages.languages import ENGLISH, LANGUAGES

OTHERS = LANGUAGES.keys() - {ENGLISH}


@pytest.fixture(scope="module")
def found():
    return found_texts()


@pytest.mark.parametrize("language", OTHERS)
def test_a_catalogue_has_the_texts_of_the_pages_and_no_others(language, found):
    stored, written = (
        {message.id for message in catalogue if message.id} for catalogue in (read_catalogue(language), found)
    )
    assert stored == written, "make texts brings the catalogues up to date"


@pytest.mark.parametrize("language", OTHERS)
def test_every_text_is_translated(language):
    assert not [message.id for message in untranslated(read_catalogue(language))]


@pytest.mark.parametrize("language", OTHERS)
def test_translations_have_the_places_of_their_texts(language):
    catalogue = read_catalogue(language)
    for message in catalogue:
        if message.id and all([message.string] if isinstance(message.string, str) else message.string):
            for check in checkers:
                check(catalogue, message)
