"""English words that the product itself stores in rows, in the reader's language: actors, reasons, names, changes."""

import re
from collections.abc import Callable

from sawmill_service.pages.frame.languages import marked

BY_HAND = "by hand on a page"
_WORDS = frozenset(
    {
        marked("by hand on a page"),
        marked("the service"),
        marked("somebody at this machine"),
        marked("the request"),
        marked("L-shape"),
        marked("Rectangle with hole"),
        marked("example tee"),
        marked("example scanner"),
        marked("example-spare scanner"),
        marked("example: a log with the L-shaped phantom on its end"),
        marked("nothing was changed"),
    }
)
_SENTENCES = (
    (re.compile(r"(?P<name>.+) on the command line"), marked("%(name)s on the command line")),
    (re.compile(r"schedule (?P<id>[a-z0-9-]+)"), marked("schedule %(id)s")),
    (
        re.compile(r"the rays pass; (?P<who>.+) asked for activation on pass"),
        marked("the rays pass; %(who)s asked for activation on pass"),
    ),
)
# A change of settings, as the history stores it: `tolerances.ray_change_mm: 0.4, was 0.5`.
_CHANGE = re.compile(r"(?P<name>[a-z_.]+): (?P<now>.+?), was (?P<before>.+?)(?=; [a-z_.]+: |$)")


def stored_words(text: str, translate: Callable[[str], str], labels: Callable[[str], str] = str) -> str:
    """Return a stored text in the reader's language; a text of a person stays as it is.

    Parameters
    ----------
    text
        Text of a row: an actor, a reason, a name, or changes of settings.
    translate
        Translation of an English text.
    labels
        Label of a setting by its name in the API, translated.
    """
    if text in _WORDS:
        return translate(text)
    for pattern, template in _SENTENCES:
        found = pattern.fullmatch(text)
        if found is not None:
            parts = {name: stored_words(part, translate) for name, part in found.groupdict().items()}
            return translate(template) % parts
    if _CHANGE.match(text):
        changed = translate(marked("%(name)s: %(now)s, was %(before)s"))
        return _CHANGE.sub(lambda each: changed % {**each.groupdict(), "name": labels(each["name"])}, text)
    return text
