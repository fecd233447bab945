"""Messages for people: a code with values, from which a sentence is made in any language.

A message has up to three English templates. The headline says what is the matter, the action what to do, first thing
first, and the details give the physics and the statistics. Places have the form of Python's formats: `%(moved_mm).2f`
has two decimals, `%(moved_mm).2g` two significant digits, `%(moved_mm)+.2f` a sign.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, Self

GROUP = "scanner"  # name of a group of jobs: groups take turns in the queue, and an event has the id of its group


def N_(text: str) -> str:  # noqa: N802 - Babel's word for a text that is translated when it is shown
    """Mark a text for the catalogues, and return it unchanged."""
    return text


Value = float | int | str

# Values that are words, as they are read.
WORDS: Mapping[str, str] = {
    "as-drawn": N_("seen as drawn"),
    "from-behind": N_("seen from behind"),
    "as-given": N_("turning as given"),
    "reversed": N_("turning the other way"),
    "denser": N_("denser"),
    "less dense": N_("less dense"),
    "smaller": N_("smaller"),
    "larger": N_("larger"),
    "once": N_("once"),
    "twice": N_("twice"),
    "three times": N_("three times"),
    "four times": N_("four times"),
    "half a time": N_("half a time"),
    "1.5 times": N_("1.5 times"),
    "2.5 times": N_("2.5 times"),
    "five times": N_("five times"),
    "six times": N_("six times"),
}
_PLACE = re.compile(r"%\((?P<name>\w+)\)(?P<sign>\+?)(?:\.(?P<digits>\d))?(?P<kind>[sdfg])|%%")


def english_number(value: float, digits: int, *, signed: bool = False) -> str:
    """Write a number with this number of decimals in English."""
    return f"{value:{'+' if signed else ''}.{digits}f}"


@dataclass(frozen=True)
class Reader:
    """The language of a reader: the translation of a text, and the writing of a number with its decimals."""

    words: Callable[[str], str] = str
    number: Callable[..., str] = english_number
    language: str = "en"

    def localised(self, text: str) -> str:
        """Return a text in English with the decimal marks of the language."""
        return re.sub(r"(?<=\d)\.(?=\d)", self.number(0.5, 1)[1], text)


ENGLISH = Reader()


class Sentences(NamedTuple):
    """The three parts of a message in a reader's language; a part may be empty."""

    headline: str
    action: str
    details: str

    @property
    def text(self) -> str:
        """All parts in their order."""
        return " ".join(filter(None, self))


_NONE = Sentences("", "", "")


class Message(StrEnum):
    """Base of the enums of messages: each member is a code with its English templates.

    A member that is called with values, and with further reasons as its parts, gives a `Reason`. A template that is
    empty takes the sentences of the parts. Any other template has them in `%(headline)s`, `%(action)s` and
    `%(details)s`.
    """

    headline: str
    action: str
    details: str

    def __new__(cls, code: str, headline: str = "", action: str = "", details: str = "") -> Self:
        """Make a code that carries its templates."""
        message = str.__new__(cls, code)
        message._value_ = code
        message.headline, message.action, message.details = headline, action, details
        return message

    def __call__(self, *parts: "Reason", **values: Value) -> "Reason":
        """Return the reason with these values."""
        return Reason(self, values, parts)


class Reason(str):
    """An English sentence for people, with the message and the values from which it is made in any language."""

    __slots__ = ("message", "parts", "values")
    message: Message
    values: Mapping[str, Value]  # values by the names of the templates' places; the unit stands at the end of a name
    parts: tuple["Reason", ...]  # reasons that belong to this one, such as the cause of a change

    def __new__(cls, message: Message, values: Mapping[str, Value], parts: Sequence["Reason"] = ()) -> Self:
        """Make the sentence from the message and its values."""
        reason = str.__new__(cls, _in_words(message, values, parts, ENGLISH).text)
        reason.message, reason.values, reason.parts = message, dict(values), tuple(parts)
        return reason

    def __getnewargs__(self) -> tuple[Any, ...]:
        return self.message, self.values, self.parts

    def in_words(self, reader: Reader = ENGLISH) -> Sentences:
        """Return headline, action and details in the reader's language."""
        return _in_words(self.message, self.values, self.parts, reader)

    @property
    def codes(self) -> tuple[str, ...]:
        """The code, and the codes of the parts."""
        return (self.message.value, *(code for part in self.parts for code in part.codes))


def numbered(numbers: Iterable[int]) -> str:
    """Write numbers in increasing order, runs by their first and last: 3, 87-89."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    return ", ".join("-".join(map(str, run)) for run in runs)


def selected(sentences: Iterable[str], *messages: Message) -> Iterator[Reason]:
    """Select the reasons among sentences that are made of one of these messages."""
    return (each for each in sentences if isinstance(each, Reason) and each.message in messages)


def _in_words(message: Message, values: Mapping[str, Value], parts: Sequence[Reason], reader: Reader) -> Sentences:
    of_parts = [part.in_words(reader) for part in parts]
    inherited = Sentences(*(" ".join(filter(None, texts)) for texts in zip(*of_parts, strict=True))) if parts else _NONE
    known = {**values, **inherited._asdict()}
    templates = (message.headline, message.action, message.details)
    texts = [_filled(one, known, reader) if one else text for one, text in zip(templates, inherited, strict=True)]
    return Sentences(*texts)


def _filled(template: str, values: Mapping[str, Value], reader: Reader) -> str:
    """Return a template in the reader's language with its places filled."""

    def written(place: re.Match[str]) -> str:
        if place["name"] is None:
            return "%"
        value = values[place["name"]]
        if isinstance(value, str):
            return reader.words(WORDS[value]) if value in WORDS else value
        return _number(float(value), place, reader)

    return " ".join(_PLACE.sub(written, reader.words(template)).split()) if template else ""


def _number(value: float, place: re.Match[str], reader: Reader) -> str:
    digits = int(place["digits"] or 0)
    if place["kind"] == "g":
        rounded = abs(float(f"{value:.{digits}g}"))
        digits = max(0, digits - 1 - (math.floor(math.log10(rounded)) if rounded else 0))
    return reader.number(value, digits, signed=bool(place["sign"]))
