"""Descriptions, units in words and examples of the properties and parameters in the OpenAPI document.

The contracts give them. This module adds what follows from the contracts: the unit at the end of a name, the
description of a property's type, and an example of that type.
"""

from collections.abc import Iterator, Mapping
from typing import Any

Schema = dict[str, Any]

# Ends of names with the words for their units. The first end that fits holds.
UNITS: Mapping[str, tuple[str, ...]] = {
    "_mm": ("mm", "millimet"),
    "_rad": ("rad", "radian"),
    "_deg": ("degree", "deg"),
    "_percent": ("per cent", "%"),
    "_bytes": ("byte", "Byte"),
    "_s": ("second", "Second"),
}
_REFERENCE = "#/components/schemas/"


def unit_of(name: str) -> tuple[str, ...]:
    """Return the words for the unit at the end of a name; none if the name ends with no unit."""
    return next((words for end, words in UNITS.items() if name.endswith(end)), ())


def complete(schemas: dict[str, Schema], parameters: Iterator[Schema]) -> None:
    """Give every property and every parameter its description and its examples, in place."""
    for schema in schemas.values():
        _require_discriminators(schema, schemas)
    for schema in schemas.values():
        for name, described in schema.get("properties", {}).items():
            _describe(name, described, described, schemas)
    for parameter in parameters:
        _describe(parameter["name"], parameter, parameter["schema"], schemas)


def _describe(name: str, described: Schema, schema: Schema, schemas: Mapping[str, Schema]) -> None:
    described.setdefault("description", _resolved(_kind(schema), schemas).get("description", ""))
    units = unit_of(name)
    if units and not any(word in described["description"] for word in units):
        described["description"] = f"{described['description'].rstrip('.')}. In {_plural(units[0])}."
    if "examples" not in schema and (example := example_of(schema, schemas)) is not None:
        schema["examples"] = [example]


def _require_discriminators(part: Any, schemas: Mapping[str, Schema]) -> None:  # noqa: ANN401 - any JSON value
    """Require the discriminator of each choice, although it has a default in the schema of each kind."""
    if isinstance(part, dict) and isinstance(part.get("discriminator"), dict):
        name = part["discriminator"]["propertyName"]
        for reference in part["discriminator"]["mapping"].values():
            kind = _resolved({"$ref": reference}, schemas)
            kind["properties"][name].pop("default", None)
            kind["required"] = sorted({*kind.get("required", []), name})
    for each in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        _require_discriminators(each, schemas)


def _plural(unit: str) -> str:
    return f"{unit}s" if unit in {"second", "degree", "byte"} else unit


def _kind(schema: Schema) -> Schema:
    """Return the schema of the values that are not null."""
    return next((each for each in schema.get("anyOf", []) if each.get("type") != "null"), schema)


def _resolved(schema: Schema, schemas: Mapping[str, Schema]) -> Schema:
    reference = schema.get("$ref")
    return schemas[reference.removeprefix(_REFERENCE)] if reference else schema


def example_of(schema: Schema, schemas: Mapping[str, Schema]) -> Any:  # noqa: ANN401 - any JSON value
    """Return a value of a schema: an example, a default, a choice, or its required parts; None if none follows."""
    own = _resolved(_kind(schema), schemas)
    stated = [each["examples"][0] for each in (schema, own) if each.get("examples")]
    if stated:
        return stated[0]
    if schema.get("default") is not None:
        return schema["default"]
    return own["const"] if "const" in own else _example_of_parts(own, schemas)


def _example_of_parts(own: Schema, schemas: Mapping[str, Schema]) -> Any:  # noqa: ANN401 - any JSON value
    if "enum" in own:
        return own["enum"][0]
    if "oneOf" in own:
        return example_of(own["oneOf"][-1], schemas)
    if "properties" in own:
        required = own.get("required", [])
        return {name: example_of(own["properties"][name], schemas) for name in own["properties"] if name in required}
    return [example_of(own["items"], schemas)] if "items" in own else None
