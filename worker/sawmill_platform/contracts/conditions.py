"""Conditions across several fields in JSON Schema: which fields go together, as `dependentSchemas` of a contract."""

from collections.abc import Iterable, Mapping
from typing import Any

Schema = dict[str, Any]


def require(schema: Schema, name: str, *alternatives: Schema) -> None:
    """Require one of the alternatives for the whole object where the field is given, besides earlier requirements."""
    conditions = schema.setdefault("dependentSchemas", {}).setdefault(name, {"allOf": []})
    conditions["allOf"].append({"anyOf": list(alternatives)})


def one_of(name: str, values: Iterable[object], *, default: object = None) -> Schema:
    """Return the schema of a field with one of these values; the field may be left out where its default is one."""
    held = list(dict.fromkeys(_plain(value) for value in values))
    condition: Schema = {"properties": {name: {"enum": held}}}
    return condition if _plain(default) in held else condition | {"required": [name]}


def without(*names: str) -> Schema:
    """Return the schema of fields that are null or left out."""
    return {"properties": {name: {"type": "null"} for name in names}}


def bounded(schema: Schema, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Set closer bounds of numbers; a number that may be left out may also be null."""
    for name, (least, largest) in bounds.items():
        schema["properties"][name].pop("exclusiveMinimum", None)
        schema["properties"][name] |= {"minimum": least, "maximum": largest}


def _plain(value: object) -> object:
    """Return the value as JSON has it: an enum's member by its word."""
    return getattr(value, "value", value)
