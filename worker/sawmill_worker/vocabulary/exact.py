"""Numbers and truth values taken as themselves: pydantic alone reads `true` as 1.0, "2.5" as 2.5 and "off" as false.

A class whose schema passes through `exactly` refuses those, in its own fields and in tuples, lists and choices of them.
Whole numbers stand for floats, and NumPy's scalars for Python's. Texts of a query are another matter: they are never
numbers, and are read as pydantic reads them.
"""

import numbers
import re
from collections.abc import Callable
from typing import Any

# What pydantic reads: a class with these and bounds in the metadata of its fields is checked where it crosses a wall.
# Unknown fields and numbers that are not finite are refused, and an instance is looked at again.
AS_CONTRACT = {"extra": "forbid", "allow_inf_nan": False, "revalidate_instances": "always"}
_DATE = re.compile(r"\s*[0-9]{4}-")


def _number(value: object) -> object:
    if isinstance(value, (bool, str)) or _is_truth(value):
        raise ValueError(f"must be a number, not {value!r:.60}")
    return value


def _whole_number(value: object) -> object:
    if isinstance(value, float) and value.is_integer():  # JSON's 20.0, as some programs write every number
        return int(value)
    if isinstance(value, (bool, str)) or _is_truth(value) or not isinstance(value, numbers.Integral):
        raise ValueError(f"must be a whole number, not {value!r:.60}")
    return value


def _truth(value: object) -> object:
    if not (isinstance(value, bool) or _is_truth(value)):
        raise ValueError(f"must be true or false, not {value!r:.60}")
    return value


def _day(value: object) -> object:
    if isinstance(value, numbers.Number) or (isinstance(value, str) and not _DATE.match(value)):
        raise ValueError(f"must be a day as 2026-03-31, or a time as RFC 3339 writes it, not {value!r:.60}")
    return value


def _is_truth(value: object) -> bool:
    """NumPy's own: the vocabulary does not import it."""
    return type(value).__module__ == "numpy" and type(value).__name__ in {"bool", "bool_"}


_LOOKED_AT: dict[str, Callable[[object], object]] = {
    "float": _number,
    "int": _whole_number,
    "bool": _truth,
    "date": _day,
    "datetime": _day,
}
# Where a schema of pydantic's holds others.
_PARTS = ("schema", "fields", "items_schema", "choices", "values_schema", "lax_schema", "strict_schema")


Schema = Any  # pydantic's nested dictionaries, or a list of them


def exactly(schema: Schema) -> Schema:
    """The schema with a look at each number, truth value and day before pydantic reads it."""
    return rewritten(schema, _with_a_look)


def _with_a_look(schema: Schema) -> Schema | None:
    look = _LOOKED_AT.get(schema.get("type", ""))
    if look is not None:
        return {"type": "function-before", "function": {"type": "no-info", "function": look}, "schema": schema}
    return schema if schema.get("function", {}).get("function") in _LOOKED_AT.values() else None


def rewritten(schema: Schema, rewrite: Callable[[Schema], Schema | None]) -> Schema:
    """A copy in which every schema for which `rewrite` has another is that one."""
    if isinstance(schema, list | tuple):
        return type(schema)(rewritten(part, rewrite) for part in schema)
    if not isinstance(schema, dict):
        return schema
    new = rewrite(schema)
    if new is not None:
        return new
    return schema | {key: _rewritten_within(schema[key], rewrite) for key in _PARTS if key in schema}


def _rewritten_within(part: Schema, rewrite: Callable[[Schema], Schema | None]) -> Schema:
    """Fields and choices by name, or one schema."""
    if isinstance(part, dict) and not isinstance(part.get("type"), str):
        return {name: rewritten(each, rewrite) for name, each in part.items()}
    return rewritten(part, rewrite)


class Exact:
    """The base of a dataclass whose values cross a wall: its fields are read exactly."""

    __pydantic_config__ = AS_CONTRACT

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: Callable[[object], object]) -> object:
        """As pydantic asks for it."""
        return exactly(handler(source))
