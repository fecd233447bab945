"""The catalogues hold every text of the pages, in each language."""

from pathlib import Path

import pytest
from babel.messages.checkers import checkers
from babel.messages.frontend import CommandLineInterface
from babel.messages.pofile import read_po

from sawmill_service.pages.frame.languages import ENGLISH, LANGUAGES, catalogue

ROOT = Path(__file__).parents[2]
OTHERS = LANGUAGES.keys() - {ENGLISH}


@pytest.fixture(scope="module")
def texts_of_the_pages(tmp_path_factory):
    template = tmp_path_factory.mktemp("texts") / "sawmill.pot"
    folders = (
        "service/sawmill_service",
        "worker/sawmill_contracts",
        "worker/sawmill_mill",
        "worker/sawmill_vocabulary",
        "worker/sawmill_worker/pictures",
    )
    places = [str(ROOT / folder) for folder in folders]
    options = ["--mapping-file", str(ROOT / "pyproject.toml"), "--output-file", str(template)]
    CommandLineInterface().run(["pybabel", "--quiet", "extract", *options, *places])
    with template.open("rb") as file:
        return {message.id for message in read_po(file) if message.id}


@pytest.mark.slow
@pytest.mark.parametrize("language", OTHERS)
def test_a_catalogue_has_the_texts_of_the_pages_and_no_others(language, texts_of_the_pages):
    stored = catalogue(language)
    assert {message.id for message in stored if message.id} == texts_of_the_pages, "run make texts"
    assert not stored.obsolete


@pytest.mark.parametrize("language", OTHERS)
def test_every_text_is_translated_with_its_places(language):
    stored = catalogue(language)
    for message in stored:
        forms = [message.string] if isinstance(message.string, str) else message.string
        assert all(forms), message.id
        assert not message.fuzzy, message.id
        if message.id:
            for check in checkers:
                check(stored, message)
