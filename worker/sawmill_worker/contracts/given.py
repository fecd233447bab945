"""What clients give, in bodies and queries: texts that can be shown, and no number without bounds."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from sawmill_worker.contracts.base import Contract
from sawmill_worker.vocabulary import rewritten

# Control characters, line separators, half surrogates, and those that reverse the direction of what follows them: a
# name is one line that looks like what it is.
_NOT_SHOWN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_NUMBER = re.compile(r"[-+]?[\d_.]+(e[-+]?\d+)?", re.IGNORECASE)
# Of a number whose field has no closer bounds.
LARGEST_NUMBER = 10**12
# Far beyond any contract, and far below where Python gives up.
_DEEPEST = 100

Place = tuple[Any, ...]


def _bounded(schema: dict[str, Any], cls: type[Contract]) -> dict[str, Any] | None:
    """A number's schema with both bounds, another class's as it is; None for any other."""
    if schema.get("cls", cls) is not cls:
        return schema
    if schema.get("type") not in {"float", "int"}:
        return None
    low = {} if schema.keys() & {"gt", "ge"} else {"ge": -LARGEST_NUMBER}
    high = {} if schema.keys() & {"lt", "le"} else {"le": LARGEST_NUMBER}
    return schema | low | high


def _hidden(given: object, place: Place = ()) -> Iterator[InitErrorDetails]:
    """Each text with such a character, with its place, and what is too deep; spaces around a text are no part of it."""
    if len(place) > _DEEPEST:
        yield _refused(f"must be at most {_DEEPEST} objects and lists deep", place, None)
    elif isinstance(given, dict | list):
        for name, each in given.items() if isinstance(given, dict) else enumerate(given):
            yield from _hidden(each, (*place, name))
    elif isinstance(given, str) and (found := _NOT_SHOWN.search(given.strip())):
        message = f"must be without control characters, not with U+{ord(found[0]):04X} as in {given!r:.100}"
        yield _refused(message, place, given)


def shown(text: str) -> str:
    """The text without the characters that are refused in names, and without spaces around it."""
    return _NOT_SHOWN.sub("", text).strip()


def _refused(message: str, place: Place, given: object) -> InitErrorDetails:
    # Braces in a template would be read.
    kind = PydanticCustomError("value_error", "{message}", {"message": message})
    return InitErrorDetails(type=kind, loc=place, input=given)


def _no_number(given: object) -> object:
    """Which pydantic would take for seconds since 1970, in a text too."""
    if isinstance(given, int | float) or (isinstance(given, str) and _NUMBER.fullmatch(given.strip())):
        msg = f"must be a time with its offset, as in 2026-03-01T00:00:00+02:00, and not the number {given}"
        raise ValueError(msg)
    return given


def _in_utc(moment: datetime) -> datetime:
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        msg = f"{moment} is beyond what calendars hold in UTC: give a time from the year 2 to the year 9998"
        raise ValueError(msg) from None


GivenTime = Annotated[AwareDatetime, BeforeValidator(_no_number), AfterValidator(_in_utc)]


class Given(Contract):
    """What somebody sends."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type[BaseModel], handler: GetCoreSchemaHandler) -> CoreSchema:
        """As pydantic asks for it: none of its numbers is without bounds."""
        schema = super().__get_pydantic_core_schema__(source, handler)
        bounded: CoreSchema = rewritten(schema, partial(_bounded, cls=cls))
        return bounded

    @model_validator(mode="before")
    @classmethod
    def _is_of_shown_characters(cls, given: object) -> object:
        faults = list(_hidden(given))
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return given


class Queried(Given):
    """What somebody sends in a query, where every value is a text."""

    numbers_come_as_texts: ClassVar[bool] = True
