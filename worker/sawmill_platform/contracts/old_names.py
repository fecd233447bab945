"""Fields and routes that are out of use, and work until a later version refuses them (docs/http.md#old-names)."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from pydantic import BaseModel, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


@dataclass(frozen=True)
class OutOfUse:
    """Marks a field or a route: the OpenAPI document has it as deprecated, and answers to requests with it say so.

    Parameters
    ----------
    since
        The version that took it out of use.
    day
        On which that was, as in 2026-11-22.
    gone_in
        The version that refuses it, later by a minor version at least.
    instead
        What to send or ask for, for people.
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
        """As pydantic asks for it."""
        return handler(schema) | {"deprecated": True}


def out_of_use(contract: type[BaseModel]) -> Iterator[tuple[str, OutOfUse]]:
    """The names and marks of a contract's fields that are out of use."""
    for name, field in contract.model_fields.items():
        yield from ((name, mark) for mark in field.metadata if isinstance(mark, OutOfUse))
