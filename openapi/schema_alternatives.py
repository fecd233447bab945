"""Alternatives of a JSON schema's value, and their pairing before and after a change."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from contract_parts import Place, without_words

Schema = Mapping[str, Any]


def alternatives(place: Place) -> Iterator[Place]:
    """Yield the alternatives of a value, each with all constraints that hold for it."""
    schema = place.value
    for key in ("anyOf", "oneOf"):
        if key in schema:
            beside = {name: value for name, value in schema.items() if name not in {key, "default", "deprecated"}}
            for each in place.at(key).items():
                yield from alternatives(Place(each.document, {**beside, **each.value}, each.pointer))
            return
    kinds = schema["type"] if isinstance(schema.get("type"), list) else [schema.get("type")]
    for kind in kinds:
        yield place if len(kinds) == 1 else Place(place.document, {**schema, "type": kind}, place.pointer)


def pairs(were: list[Place], are: list[Place]) -> list[tuple[Place, Place]]:
    """Pair the same alternatives before and after, the most alike first, and remove them from both lists."""
    found = []
    for likeness in (_text, _marks, _family):
        if len(were) == len(are) == 1:
            break
        left = [(likeness(each.value), each) for each in are]
        for was in list(were):
            like = likeness(was.value)
            match = next((each for each in left if each[0] == like), None)
            if match is not None:
                left.remove(match)
                found.append((was, match[1]))
                were.remove(was)
                are.remove(match[1])
    if len(were) == len(are) == 1:
        found.append((were.pop(), are.pop()))
    return found


def _text(schema: Schema) -> str:
    return json.dumps(without_words(schema), sort_keys=True)


def _marks(schema: Schema) -> tuple[str, ...]:
    """Return the marks of one kind of object: the fields that have one value each."""
    properties = schema.get("properties", {})
    known = {name: choices(each) or [] for name, each in sorted(properties.items())}
    return _family(schema), *(f"{name}={values[0]}" for name, values in known.items() if len(values) == 1)


def _family(schema: Schema) -> str:
    kind = schema.get("type")
    return "number" if kind == "integer" else str(kind)


def choices(schema: Schema) -> list[str] | None:
    """Return the values of an enumeration, as JSON; None if there is none."""
    if "const" in schema:
        return [as_json(schema["const"])]
    return [as_json(each) for each in schema["enum"]] if "enum" in schema else None


def as_json(value: Any) -> str:  # noqa: ANN401 - any JSON value
    """Format a value for display."""
    return "none" if value is None else json.dumps(value, ensure_ascii=False)
