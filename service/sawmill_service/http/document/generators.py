"""Forms of schemas that generators of clients read without loss, where JSON schema has shorter ones."""

from collections.abc import Mapping
from typing import Any

Schema = dict[str, Any]

NULL = {"type": "null"}


def write_for_generators(part: Any, schemas: Mapping[str, Schema]) -> None:  # noqa: ANN401 - any JSON value
    """Rewrite a part of the document in place, at any depth.

    - Titles go: generators name a class by each.
    - "X or null" of a plain X is a list of types: generators make a class for each `anyOf`.
    - A pair states the type of its items, for generators that ignore `prefixItems`. Its length already forbids further
      items; `items: false` would repeat that, and openapi-python-client refuses it.
    - A choice requires its discriminator, although it has a default in the schema of each kind.
    """
    if isinstance(part, list):
        for inner in part:
            write_for_generators(inner, schemas)
    if not isinstance(part, dict):
        return
    for name, inner in part.items():
        if name not in {"example", "examples", "default"}:
            write_for_generators(inner, schemas)
    if isinstance(part.get("title"), str):
        del part["title"]
    if "prefixItems" in part:
        [kind] = {item["type"] for item in part["prefixItems"]}
        part["items"] = {"type": kind}
    if isinstance(part.get("discriminator"), dict):
        name = part["discriminator"]["propertyName"]
        for reference in part["discriminator"]["mapping"].values():
            kind = schemas[reference.rpartition("/")[2]]
            kind["properties"][name].pop("default", None)
            kind["required"] = sorted({*kind.get("required", []), name})
    _join_null(part)


def _join_null(part: Schema) -> None:
    """Make one schema of "X or null", if X is plain."""
    choices = [choice for choice in part.get("anyOf", []) if choice != NULL]
    if len(choices) != 1 or not isinstance(choices[0].get("type"), str):
        return
    del part["anyOf"]
    part |= choices[0] | part | {"type": [choices[0]["type"], "null"]}
    if "const" in part:
        part["enum"] = [part.pop("const"), None]
    elif "enum" in part:
        part["enum"] = [*part["enum"], None]
    if "minimum" in part:  # the smallest value of a request, above the bound that excludes 0
        part.pop("exclusiveMinimum", None)
