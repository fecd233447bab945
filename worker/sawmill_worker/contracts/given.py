"""What clients give: bodies and queries, whose texts and numbers are looked at before anything else is."""

import re
from collections.abc import Iterator
from typing import Any, ClassVar

from pydantic import ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from sawmill_worker.contracts.base import Contract

# Control characters, line separators, half surrogates, and those that reverse the direction of what follows them: a
# name is one line that looks like what it is.
_NOT_SHOWN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
# Of any number in a body; most have closer bounds.
LARGEST_NUMBER = 1e12

Place = tuple[Any, ...]


class Given(Contract):
    """What somebody sends: no text in it holds a control character, no number is larger than any measure."""

    @model_validator(mode="before")
    @classmethod
    def _can_be_meant(cls, given: object) -> object:
        faults = list(_faults(given))
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return given


class Queried(Given):
    """What somebody sends in a query, where every value is a text."""

    numbers_come_as_texts: ClassVar[bool] = True


def _faults(given: object, place: Place = ()) -> Iterator[InitErrorDetails]:
    """Of each value that cannot be meant, with its place; spaces around a text are no part of it."""
    if isinstance(given, dict | list):
        for name, each in given.items() if isinstance(given, dict) else enumerate(given):
            yield from _faults(each, (*place, name))
    elif isinstance(given, str):
        if found := _NOT_SHOWN.search(given.strip()):
            yield _fault(
                place, given, f"without control characters, not with U+{ord(found[0]):04X} as in {given!r:.100}"
            )
    elif isinstance(given, int | float) and abs(given) > LARGEST_NUMBER:
        yield _fault(place, given, f"a number within ±{LARGEST_NUMBER:g}, not {given!r:.60}")


def _fault(place: Place, value: object, right: str) -> InitErrorDetails:
    # Braces in a template would be read.
    kind = PydanticCustomError("value_error", "{message}", {"message": f"must be {right}"})
    return InitErrorDetails(type=kind, loc=place, input=value)
