"""The base of every contract, types that many share, strict JSON, and fields and routes out of use."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from typing import Annotated, Any, Generic, Self, TypeVar

from pydantic import (
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    StringConstraints,
    TypeAdapter,
    ValidationError,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, from_json, to_json

from sawmill_platform.contracts import patterns


class Contract(BaseModel):
    """A frozen model that refuses unknown fields and non-finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_strip_whitespace=True)

    @classmethod
    def of_row(cls, row: object, **other: object) -> Self:
        """Read the contract from a row, whose columns have the names of fields, and from other values by field."""
        columns = {name: getattr(row, name) for name in cls.model_fields if name not in other and hasattr(row, name)}
        return cls.model_validate(columns | other)


Identifier = Annotated[
    str,
    StringConstraints(pattern=r"^[a-z0-9][a-z0-9-]{0,63}$"),
    Field(description="Lower-case letters, digits and hyphens.", examples=["example"]),
]
Name = Annotated[
    str,
    StringConstraints(min_length=1, max_length=200),
    Field(description="One line that is not blank.", json_schema_extra={"pattern": patterns.NAME}),
]
# Bound of a number whose field has no closer one.
LARGEST_NUMBER = 10**12
Time = Annotated[AwareDatetime, Field(description="RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])]
Sha256 = Annotated[str, Field(examples=["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"])]


def link(to: str, example: str) -> Any:  # noqa: ANN401 - as pydantic's Field
    """Return the field of a path to a resource."""
    return Field(description=f"Path of {to}.", examples=[f"/v1/{example}"])


def complaint(error: ValidationError) -> str:
    """Return a contract's first complaint."""
    return _message(error.errors()[0])


def placed_complaint(error: ValidationError) -> str:
    """Return a contract's first complaint, after the place of the value."""
    return placed_complaints(error)[0]


def placed_complaints(error: ValidationError) -> list[str]:
    """Return all of a contract's complaints, each after the place of the value."""
    placed = ((".".join(map(str, detail["loc"])), _message(detail)) for detail in error.errors())
    return [f"{place}: {message}" if place else message for place, message in placed]


def _message(detail: ErrorDetails) -> str:
    # Pydantic has another text for a field that a dataclass does not have.
    if detail["type"] == "unexpected_keyword_argument":
        return "Extra inputs are not permitted"
    return detail["msg"].removeprefix("Value error, ")


def near_name(name: str, names: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name: a similar known name; empty if there is none."""
    near = get_close_matches(name, sorted(names), n=1)
    return f": {near[0]!r} is" if near else ""


Item = TypeVar("Item")


class Page(Contract, Generic[Item]):
    """A page of a list, newest first; `next` is the cursor of the following page."""

    model_config = ConfigDict(json_schema_extra={"description": "One page of a list, newest first."})

    @classmethod
    def model_parametrized_name(cls, params: tuple[Any, ...]) -> str:
        """Name the model as pydantic needs it: `JobPage` for pages of `Job`."""
        [item] = params
        return f"{getattr(item, 'model_config', {}).get('title', item.__name__)}Page"

    items: list[Item] = Field(description="Items of this page, newest first.")
    next: str | None = Field(
        None,
        description="Pass as `after` to get the following page; null on the last.",
        examples=["1772429400000000.example"],
    )


class Stamped(Contract):
    """Fields of every stored resource."""

    id: Identifier = Field(description="The resource's id, which the service gives.")
    created_at: datetime = Field(description="Time of creation, RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])


# Bytes with which .NET and PowerShell begin texts.
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_EXACT = 2**53


def read_strictly(contract: TypeAdapter[Any], text: bytes) -> Any:  # noqa: ANN401 - what the contract is of
    """Read JSON as a contract.

    Raises
    ------
    ValidationError
        The text is no JSON, or not what the contract describes.
    """
    text = text.removeprefix(BYTE_ORDER_MARK)
    with suppress(ValueError):  # the contract refuses what is no JSON
        text = to_json(_with_whole_numbers(from_json(text)), inf_nan_mode="constants")
    return contract.validate_json(text, strict=True)


def _with_whole_numbers(value: Any) -> Any:  # noqa: ANN401 - JSON
    """Replace each 20.0 by 20, also in lengths: some programs write every number as a float."""
    if isinstance(value, dict):
        return {name: _with_whole_numbers(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_with_whole_numbers(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT else value


@dataclass(frozen=True)
class OutOfUse:
    """Mark of a field or a route out of use: deprecated in the OpenAPI document and in answers to requests with it.

    Parameters
    ----------
    since
        The version that took it out of use.
    day
        Date of that version, as in 2026-11-22.
    gone_in
        The version that refuses the name, later by a minor version at least.
    instead
        What to send or request instead, for people.
    """

    since: str
    day: str
    gone_in: str
    instead: str

    @property
    def moment(self) -> datetime:
        """The start of the day, UTC."""
        return datetime.fromisoformat(self.day).replace(tzinfo=UTC)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Mark the schema as deprecated; pydantic calls this method."""
        return handler(schema) | {"deprecated": True}


def out_of_use(contract: type[BaseModel]) -> Iterator[tuple[str, OutOfUse]]:
    """Return the names and marks of a contract's fields that are out of use."""
    for name, field in contract.model_fields.items():
        yield from ((name, mark) for mark in field.metadata if isinstance(mark, OutOfUse))
