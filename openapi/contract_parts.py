"""Places in OpenAPI documents, past references, and what is kept of a change between two of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

# Texts for people. What distinguishes the kinds of a choice is in the kinds themselves.
WORDS = {"title", "description", "summary", "examples", "example", "externalDocs", "discriminator", "readOnly"}
# Objects whose members have free names, which may be one of these words.
NAMED = {"properties", "dependentSchemas", "patternProperties", "paths", "responses", "schemas", "headers"}
EXTENSIONS = {"x-problem-codes", "x-event-data"}


class Kind(IntEnum):
    """The effect of a change on programs."""

    ADDITION = 1
    INCOMPATIBLE = 2


@dataclass(frozen=True, order=True)
class Change:
    """A change, with its JSON pointer into the later document or, for removed parts, into the earlier one."""

    pointer: str
    what: str
    kind: Kind

    def __str__(self) -> str:
        return f"{self.kind.name.lower()}: {self.pointer}: {self.what}"


@dataclass(frozen=True)
class Place:
    """A place in a document, past its references; where nothing is, an empty object."""

    document: Mapping[str, Any]
    value: Any
    pointer: str = ""

    def at(self, *keys: str | int) -> "Place":
        """Return a place further in."""
        place = self
        for key in keys:
            inner = place.value[key] if isinstance(key, int) else place.value.get(key, {})
            place = Place(place.document, inner, place.pointer_to(key)).resolved()
        return place

    def pointer_to(self, key: str | int) -> str:
        """Return the JSON pointer of a member (RFC 6901), whether or not it is a reference."""
        return f"{self.pointer}/{str(key).replace('~', '~0').replace('/', '~1')}"

    def items(self) -> Iterator["Place"]:
        """Yield the places of a list."""
        return (self.at(index) for index in range(len(self.value)))

    def resolved(self) -> "Place":
        """Return the target of a reference, merged with the keys next to it; the place itself if it is no reference."""
        if not isinstance(self.value, dict) or not isinstance(self.value.get("$ref"), str):
            return self
        keys = [key.replace("~1", "/").replace("~0", "~") for key in self.value["$ref"].removeprefix("#/").split("/")]
        target = Place(self.document, self.document).at(*keys)
        beside = {key: value for key, value in self.value.items() if key != "$ref"}
        alone = beside.keys() <= WORDS | {"default", "deprecated"}  # else it is no longer what the others refer to
        return Place(self.document, {**target.value, **beside}, target.pointer if alone else self.pointer)


def without_words(part: Any) -> Any:  # noqa: ANN401 - any JSON value
    """Return a document, or a part of one, without the texts for people."""
    if isinstance(part, list):
        return [without_words(each) for each in part]
    if not isinstance(part, dict):
        return part
    kept = {}
    for key, value in part.items():
        if key in NAMED:
            kept[key] = {name: without_words(each) for name, each in value.items()}
        elif key not in WORDS and (not key.startswith("x-") or key in EXTENSIONS):
            kept[key] = without_words(value)
    return kept
