"""Docstrings, comments and the public document are sentences that can be read alone (tests/support/sentences.py)."""

import json
import re

import sentences


def test_few_docstrings_begin_with_a_preposition_or_a_pronoun_and_few_words_are_private():
    paths = sentences.sources()
    texts = [text for path in paths for text in sentences.docstrings(path)]
    opening = [text.place for text in texts if sentences.OPENING.match(text.text)]
    assert len(texts) > 4000  # else the search finds nothing
    # The pattern takes some good openings for bad ones: "Before and after a job".
    assert len(opening) <= 0.01 * len(texts), opening
    lines = sum(len(path.read_text().splitlines()) for path in paths)
    texts += [text for path in paths for text in sentences.comments(path)]
    private = [(text.place, word) for text in texts for word in sentences.PRIVATE.findall(text.text)]
    # "of its" and "stands" have plain uses too: some 60 places in 81 000 lines.
    assert len(private) <= 1.5 * lines / 1000, private


def test_no_text_of_the_public_document_is_a_fragment():
    texts = list(sentences.descriptions(json.loads((sentences.ROOT / "openapi/openapi.json").read_text())))
    assert len(texts) > 1000  # else the search finds nothing
    assert not [text for text in texts if any(map(sentences.FRAGMENT.match, re.split(r"(?<=[.])\s+", text.text)))]
