"""Changes between two JSON schemas of OpenAPI documents, for clients that send and for clients that read values.

What a request could hold it can hold still, with the same meaning. What an answer promised still comes. An answer may
have more fields, and the bounds of its values may move: its readers need not check them. A new word of an enumeration
or a new type of a value in an answer is incompatible, since generated clients refuse to read it.
"""

import json
from collections.abc import Callable
from typing import Any

from contract_parts import Change, Kind, Place, without_words
from schema_alternatives import Schema, alternatives, as_json, choices, pairs

# Lower bounds have the sign of plus; of two with one value the later keyword is the narrower.
BOUNDS: tuple[tuple[Any, ...], ...] = (
    (1, "minimum", "exclusiveMinimum"),
    (-1, "maximum", "exclusiveMaximum"),
    *((1, f"min{what}") for what in ("Length", "Items", "Properties")),
    *((-1, f"max{what}") for what in ("Length", "Items", "Properties")),
)
# Compared by their meaning. Of any other keyword it is only known whether it is as it was.
UNDERSTOOD = {
    *("type", "format", "enum", "const", "default", "deprecated", "anyOf", "oneOf", "items", "prefixItems"),
    *("properties", "required", "additionalProperties", "propertyNames"),
    *(key for _, *keys in BOUNDS for key in keys),
}
SIDES = {True: "in requests", False: "in answers"}


class SchemaChanges:
    """Collects changes; each pair of types is compared once for requests and once for answers."""

    def __init__(self) -> None:
        self.found: set[Change] = set()
        self._seen: set[tuple[str, str, bool]] = set()

    def note(self, kind: Kind, place: Place, what: str, key: str | None = None) -> None:
        """Keep one change, of a place or a member."""
        self.found.add(Change(place.pointer if key is None else place.pointer_to(key), what, kind))

    def members(
        self, old: Place, new: Place, of: str, *, added: Callable[[str], Kind] = lambda _: Kind.ADDITION
    ) -> dict[str, tuple[Place, Place]]:
        """Record an object's members that are gone or new, which `added` judges, and return the common ones."""
        for key in old.value.keys() - new.value.keys():
            self.note(Kind.INCOMPATIBLE, old, f"the {of} {key} is gone", key)
        for key in new.value.keys() - old.value.keys():
            self.note(added(key), new, f"the {of} {key} is new", key)
        return {key: (old.at(key), new.at(key)) for key in old.value if key in new.value}

    def compare_value(self, old: Place, new: Place, key: str) -> None:
        """Record the change of a value that must stay as it is where it was stated."""
        if key in old.value and old.value[key] != new.value.get(key):
            before, after = as_json(old.value[key]), as_json(new.value[key]) if key in new.value else "none"
            self.note(Kind.INCOMPATIBLE, new, f"{key} from {before} to {after}", key)

    def compare_deprecation(self, old: Place, new: Place) -> None:
        """Record a deprecation (Semantic Versioning, item 7)."""
        if new.value.get("deprecated", False) and not old.value.get("deprecated", False):
            self.note(Kind.ADDITION, new, "is deprecated now")

    def compare(self, old: Place, new: Place, *, asked: bool) -> None:
        """Record the changes between two schemas, of requests (`asked`) or of answers."""
        old, new = _as_object(old), _as_object(new)
        self.compare_deprecation(old, new)
        if asked:
            self.compare_value(old, new, "default")
        seen = (old.pointer, new.pointer, asked)
        if seen in self._seen:
            return
        self._seen.add(seen)
        were, are = list(alternatives(old)), list(alternatives(new))
        for was, now in pairs(were, are):
            self._compare_one(was, now, asked=asked)
        for gone in were:
            self._narrower(gone, f"{_named(gone)} is gone from what it can be", asked=asked)
        for added in are:
            self._wider(added, f"{_named(added)} is new in what it can be", asked=asked)

    def _narrower(self, place: Place, what: str, *, asked: bool) -> None:
        self.note(Kind.INCOMPATIBLE if asked else Kind.ADDITION, place, f"{what}, {SIDES[asked]}")

    def _wider(self, place: Place, what: str, *, asked: bool) -> None:
        self.note(Kind.ADDITION if asked else Kind.INCOMPATIBLE, place, f"{what}, {SIDES[asked]}")

    def _compare_one(self, old: Place, new: Place, *, asked: bool) -> None:
        self._types(old, new, asked=asked)
        self._words(old, new, asked=asked)
        self._bounds(old, new, asked=asked)
        self._rules(old, new, asked=asked)
        self._objects(old, new, asked=asked)
        self._arrays(old, new, asked=asked)

    def _types(self, old: Place, new: Place, *, asked: bool) -> None:
        for key in ("type", "format"):
            was, now = old.value.get(key), new.value.get(key)
            what = f"{key} from {as_json(was)} to {as_json(now)}"
            if (now is None and was is not None) or (was, now) == ("integer", "number"):
                self._wider(new.at(key), what, asked=asked)
            elif (was is None and now is not None) or (was, now) == ("number", "integer"):
                self._narrower(new.at(key), what, asked=asked)
            elif was != now:
                self.note(Kind.INCOMPATIBLE, new.at(key), f"{what}, {SIDES[asked]}")

    def _words(self, old: Place, new: Place, *, asked: bool) -> None:
        was, now = choices(old.value), choices(new.value)
        if was is None and now is not None:
            self._narrower(new, f"any value before, now one of {', '.join(now)}", asked=asked)
        elif was is not None and now is None:
            self._wider(new, f"one of {', '.join(was)} before, now any value", asked=asked)
        elif was is not None and now is not None:
            for word in (each for each in was if each not in now):
                self._narrower(new, f"the value {word} is gone", asked=asked)
            for word in (each for each in now if each not in was):
                self._wider(new, f"the value {word} is new", asked=asked)

    def _bounds(self, old: Place, new: Place, *, asked: bool) -> None:
        for sign, *keys in BOUNDS:
            was, now = _bound(old.value, keys, sign), _bound(new.value, keys, sign)
            if was != now:
                narrower = now is not None and (was is None or now > was)
                before, after = (
                    "none" if found is None else f"{keys[found[1]]} {found[0] * sign}" for found in (was, now)
                )
                kind = Kind.INCOMPATIBLE if asked and narrower else Kind.ADDITION
                self.note(kind, new, f"bound from {before} to {after}, {SIDES[asked]}")

    def _rules(self, old: Place, new: Place, *, asked: bool) -> None:
        was, now = (_rules(place.value) for place in (old, new))
        for rule in sorted({*was, *now}):
            if was.get(rule) != now.get(rule):
                what = f"{rule} from {was.get(rule, 'none')} to {now.get(rule, 'none')}, {SIDES[asked]}"
                self.note(Kind.INCOMPATIBLE if asked and rule in now else Kind.ADDITION, new.at(rule), what)

    def _objects(self, old: Place, new: Place, *, asked: bool) -> None:
        was, now = old.at("properties"), new.at("properties")
        required_before, required = (set(place.value.get("required", [])) for place in (old, new))
        for name in was.value.keys() - now.value.keys():
            self.note(Kind.INCOMPATIBLE, was, f"the field {name} is gone, {SIDES[asked]}", name)
        for name in now.value.keys() - was.value.keys():
            kind = Kind.INCOMPATIBLE if asked and name in required else Kind.ADDITION
            needed = ", and required" if asked and name in required else ""
            self.note(kind, now, f"the field {name} is new{needed}, {SIDES[asked]}", name)
        for name in (each for each in was.value if each in now.value):
            if name in required - required_before:
                self._narrower(now.at(name), f"the field {name} is required, and was not", asked=asked)
            if name in required_before - required:
                self._wider(now.at(name), f"the field {name} is no longer required", asked=asked)
            self.compare(was.at(name), now.at(name), asked=asked)
        self._inner(old, new, "propertyNames", asked=asked)
        is_open = _open(new.value)
        if _open(old.value) != is_open:
            what = f"fields that are not listed are {'allowed' if is_open else 'refused'} now, {SIDES[asked]}"
            self.note(Kind.INCOMPATIBLE if asked and not is_open else Kind.ADDITION, new, what)
        elif is_open:
            self._inner(old, new, "additionalProperties", asked=asked)

    def _arrays(self, old: Place, new: Place, *, asked: bool) -> None:
        self._inner(old, new, "items", asked=asked)
        was, now = (place.value.get("prefixItems", []) for place in (old, new))
        if len(was) != len(now):
            self.note(Kind.INCOMPATIBLE, new, f"values by position from {len(was)} to {len(now)}, {SIDES[asked]}")
        for index in range(min(len(was), len(now))):
            self.compare(old.at("prefixItems", index), new.at("prefixItems", index), asked=asked)

    def _inner(self, old: Place, new: Place, key: str, *, asked: bool) -> None:
        """Compare a schema within another; an absent one allows everything."""
        if key in old.value or key in new.value:
            self.compare(old.at(key), new.at(key), asked=asked)


def _as_object(place: Place) -> Place:
    """Return a boolean schema as an object: `true` allows everything, `false` nothing."""
    if isinstance(place.value, bool):
        return Place(place.document, {} if place.value else {"not": {}}, place.pointer)
    return place


def _named(place: Place) -> str:
    _, named, name = place.pointer.rpartition("/components/schemas/")
    return name if named else str(place.value.get("type", "any value"))


def _bound(schema: Schema, keys: list[str], sign: int) -> tuple[float, int] | None:
    """Return the narrowest bound as (value times sign, index of the key): the greater, the narrower."""
    return max(((sign * schema[key], index) for index, key in enumerate(keys) if key in schema), default=None)


def _rules(schema: Schema) -> dict[str, str]:
    """Return the keywords that are only compared, as text."""
    others = without_words({key: value for key, value in schema.items() if key not in UNDERSTOOD})
    return {key: json.dumps(value, sort_keys=True) for key, value in others.items()}


def _open(schema: Schema) -> bool:
    return schema.get("additionalProperties", True) is not False
