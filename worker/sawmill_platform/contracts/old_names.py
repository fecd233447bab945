"""Fields and routes out of use, until a later version refuses them (docs/look-up/http.md#old-names)."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from pydantic import BaseModel, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


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
