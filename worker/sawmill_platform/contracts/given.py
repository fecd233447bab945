"""The base of request bodies and queries, and the types of their texts, days and times."""

import re
from collections.abc import Iterator
from datetime import UTC, date, datetime
from typing import Annotated, Any, Self

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, TypeAdapter, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Contract

# Characters that are not shown: the patterns' characters, half surrogates, format characters beyond the first plane.
_NOT_SHOWN = re.compile(
    rf"[{patterns.NOT_SHOWN}\ud800-\udfff\U000110bd\U000110cd\U00013430-\U0001343f\U0001bca0-\U0001bca3"
    r"\U0001d173-\U0001d17a\U000e0001\U000e0020-\U000e007f]"
)
_NUMBER = re.compile(r"[-+]?[\d_.]+(e[-+]?\d+)?", re.IGNORECASE)
_DAY = re.compile("[0-9]{4}-[0-9]{2}-[0-9]{2}")
_TIME = TypeAdapter(AwareDatetime)

Place = tuple[Any, ...]


def hidden_characters(sent: dict[str, Any] | list[Any]) -> Iterator[dict[str, Any]]:
    """Find each text with a character that is not shown: a fault as pydantic lists it, with its place."""
    ahead: list[tuple[Place, Any]] = [((), sent)]
    while ahead:
        place, within = ahead.pop()
        for name, value in within.items() if isinstance(within, dict) else enumerate(within):
            if isinstance(value, dict | list):
                ahead.append(((*place, name), value))
            elif isinstance(value, str) and (hidden := _NOT_SHOWN.search(value.strip())):
                wrong = f"U+{ord(hidden[0]):04X} as in {value!r:.100}"
                message = f"must be without control characters and invisible ones, not with {wrong}"
                yield {"type": "value_error", "loc": (*place, name), "msg": message, "input": value}


def shown(text: str) -> str:
    """Leave out the characters that are refused in names, and the spaces around the text."""
    return _NOT_SHOWN.sub("", text).strip()


def _as_day(value: object) -> date:
    """Read a day; pydantic would read a number, also in a text, as seconds since 1970."""
    if isinstance(value, str) and _DAY.fullmatch(value.strip()):
        return date.fromisoformat(value.strip())
    if isinstance(value, date):
        return value
    raise ValueError(f"should be a valid date, not {value!r:.100}: write it as in 2026-03-31")


def _as_time(value: object) -> object:
    """Read a time; pydantic would read a number, also in a text, as seconds since 1970."""
    if isinstance(value, int | float) or (isinstance(value, str) and _NUMBER.fullmatch(value.strip())):
        raise ValueError(f"must be a time with its offset, as in 2026-03-01T00:00:00+02:00, and not the number {value}")
    # Strict JSON has no texts for a validator that follows this one.
    return _TIME.validate_python(value)


def _in_utc(moment: datetime) -> datetime:
    try:
        return moment.astimezone(UTC)
    except OverflowError:
        raise ValueError(
            f"{moment} is beyond what calendars hold in UTC: give a time from the year 2 to the year 9998"
        ) from None


GivenDay = Annotated[date, BeforeValidator(_as_day)]
GivenTime = Annotated[AwareDatetime, BeforeValidator(_as_time), AfterValidator(_in_utc)]


class Given(Contract):
    """The base of a body or a query, whose texts have no control characters.

    A model of bodies has no validator of mode "before" or "wrap" above a tuple, a date or a time: pydantic hands the
    Python values of such a validator on, in which the lists and texts of strict JSON are none of these.
    """

    @model_validator(mode="after")
    def _is_of_shown_characters(self) -> Self:
        faults = [
            InitErrorDetails(
                # Braces in a template would be read.
                type=PydanticCustomError("value_error", "{message}", {"message": fault["msg"]}),
                loc=fault["loc"],
                input=fault["input"],
            )
            for fault in hidden_characters(dict(self))
        ]
        if faults:
            raise ValidationError.from_exception_data(type(self).__name__, faults)
        return self
