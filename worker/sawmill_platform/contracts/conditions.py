"""What JSON Schema states of several fields together: which go with which, as `dependentSchemas` of a contract."""

from collections.abc import Iterable, Mapping
from typing import Any

Schema = dict[str, Any]


def require(schema: Schema, name: str, *alternatives: Schema) -> None:
    """Where the field is given, one of the alternatives holds of the whole object; earlier ones hold too."""
    conditions = schema.setdefault("dependentSchemas", {}).setdefault(name, {"allOf": []})
    conditions["allOf"].append({"anyOf": list(alternatives)})


def one_of(name: str, values: Iterable[object], *, default: object = None) -> Schema:
    """The field has one of the values; it may be left out where its default is one."""
    held = list(dict.fromkeys(_plain(value) for value in values))
    condition: Schema = {"properties": {name: {"enum": held}}}
    return condition if _plain(default) in held else condition | {"required": [name]}


def without(*names: str) -> Schema:
    """The fields are null or left out."""
    return {"properties": {name: {"type": "null"} for name in names}}


def bounded(schema: Schema, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Closer bounds of numbers, which are null too where they may be left out."""
    for name, (least, largest) in bounds.items():
        schema["properties"][name].pop("exclusiveMinimum", None)
        schema["properties"][name] |= {"minimum": least, "maximum": largest}


def _plain(value: object) -> object:
    """As JSON has it: the word of an enum."""
    return getattr(value, "value", value)
