"""Filter of the audit's page, kept in the address, and the values of an entry as the page lists them."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import urlencode

from fastapi import Query

from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_service.pages.lists import SHOWN, check_zone, day_of, parse_day

PER_PAGE = 50


@dataclass(frozen=True)
class AuditFilter:
    """Selection of the entries that the page lists.

    Attributes
    ----------
    who : str
        Name of the actor; empty: everybody.
    action : EventKind or None
        Kind of the action; None: all kinds.
    first, last : date or None
        First and last day.
    zone : str
        Time zone of these days; empty: this machine's.
    after : str or None
        Cursor of the previous page.
    """

    who: str
    action: EventKind | None
    first: date | None
    last: date | None
    zone: str
    after: str | None

    def arguments(self) -> dict[str, Any]:
        """Return the selection as arguments for the audit."""
        since = None if self.first is None else day_of(self.first, self.zone)[0]
        until = None if self.last is None else day_of(self.last, self.zone)[1]
        return {"who": self.who or None, "action": self.action, "since": since, "until": until}

    def address(self, after: str | None = None) -> str:
        """Return the query of this page from the first entry on, or from a cursor on."""
        return "?" + urlencode({name: value for name, value in (vars(self) | {"after": after}).items() if value})


def read_filter(
    who: Annotated[str, Query(max_length=200)] = "",
    action: EventKind | Literal[""] = "",
    first: Annotated[str, Query(max_length=20)] = "",
    last: Annotated[str, Query(max_length=20)] = "",
    zone: Annotated[str, Query(max_length=64)] = "",
    after: Annotated[str, Query(max_length=200, pattern=SHOWN)] = "",
) -> AuditFilter:
    """Read the selection from a form, which sends an empty text for an empty field."""
    span = parse_day("first", first), parse_day("last", last)
    return AuditFilter(who, action or None, *span, check_zone(zone), after or None)


class EntryValue(NamedTuple):
    """Value of an entry under its name in the API; `before` is None where the action did not change a value."""

    name: str
    before: str | None
    now: str


def values_of(entry: AuditEntry) -> list[EntryValue]:
    """Return the values of an entry; of a change those that differ, each with the value before."""
    detail = entry.detail or {}
    if not entry.action.endswith("-changed"):
        return [EntryValue(name, None, _written(value)) for name, value in detail.items() if value is not None]
    return [each for name, (before, now) in detail.items() for each in _differences(name, before, now)]


def _differences(name: str, before: object, now: object) -> Iterator[EntryValue]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            yield from _differences(f"{name}.{key}", before.get(key), now.get(key))
    elif before != now:
        yield EntryValue(name, _written(before), _written(now))


def _written(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}: {_written(part)}" for name, part in value.items() if part is not None)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
