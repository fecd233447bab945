"""The base of every contract, and the few types that many of them share."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated, Generic, TypeVar

from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field, StringConstraints


class Contract(BaseModel):
    """A frozen model that refuses unknown fields and non-finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True)


class Handedness(StrEnum):
    """From which end the phantom was looked at (DESIGN section 3)."""

    AS_DRAWN = "as-drawn"
    FROM_BEHIND = "from-behind"


class Rotation(StrEnum):
    """Which way the angles count: as the scan gives them, or the other way."""

    AS_GIVEN = "as-given"
    REVERSED = "reversed"


class DataKind(StrEnum):
    """What the numbers of a scan are. Never guessed."""

    COUNTS = "counts"
    LINE_INTEGRALS = "line-integrals"


Identifier = Annotated[
    str,
    StringConstraints(pattern=r"^[a-z0-9][a-z0-9-]{0,63}$"),
    Field(description="Lower-case letters, digits and hyphens.", examples=["example"]),
]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]
PositiveMm = Annotated[float, Field(gt=0, le=1e5)]
Time = Annotated[AwareDatetime, Field(description="RFC 3339, UTC.")]


def _check_rows(text: str) -> str:
    first, _, last = text.partition(":")
    if not (first.isdigit() and last.isdigit() and int(first) < int(last)):
        msg = f"rows must be A:B with 0 <= A < B, as in 0:16, not {text!r}"
        raise ValueError(msg)
    return text


Rows = Annotated[
    str,
    AfterValidator(_check_rows),
    Field(description="Detector rows A:B, the first included, the last not.", examples=["0:16"]),
]


def parse_rows(rows: str) -> tuple[int, int]:
    """Split A:B into its two numbers."""
    first, last = _check_rows(rows).split(":")
    return int(first), int(last)


def _check_range(value: tuple[float, float]) -> tuple[float, float]:
    if not value[0] < value[1]:
        msg = f"a range must be [low, high] with low < high, not {list(value)}"
        raise ValueError(msg)
    return value


Range = Annotated[tuple[float, float], AfterValidator(_check_range)]


Item = TypeVar("Item")


class Page(Contract, Generic[Item]):
    """One page of a list, newest first; `next` is the cursor of the following page."""

    items: list[Item]
    next: str | None = Field(None, description="Pass as `after` to get the following page; null on the last.")


class Stamped(Contract):
    """What every stored resource carries."""

    id: Identifier
    created_at: datetime
