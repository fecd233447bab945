"""Filter of the audit's page, kept in the address, and the values of an entry as the page lists them."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import urlencode

from fastapi import Query

from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_service.pages.lists import SHOWN, DaySpan, TheSpan

PER_PAGE = 50
# Each morning has many; they are shown where they are asked for.
_LOGINS = (event_kinds.LOGGED_IN, event_kinds.LOGGED_OUT)


@dataclass(frozen=True)
class AuditFilter(DaySpan):
    """Selection of the entries that the page lists."""

    who: str  # name of the actor; empty: everybody
    action: EventType | None  # kind of the action; None: all kinds
    logins: str  # not empty: log-ins and log-outs too
    after: str | None  # cursor of the previous page

    def arguments(self) -> dict[str, Any]:
        """Return the selection as arguments for the audit."""
        without = () if self.logins or self.action in _LOGINS else _LOGINS
        return {
            "who": self.who or None,
            "action": self.action,
            "without": without,
            "after": self.after,
            **self.bounds(),
        }

    def address(self, after: str | None = None) -> str:
        """Return the query of this page from the first entry on, or from a cursor on."""
        return "?" + urlencode({name: value for name, value in (vars(self) | {"after": after}).items() if value})


def read_filter(
    span: TheSpan,
    who: Annotated[str, Query(max_length=200)] = "",
    action: EventType | Literal[""] = "",
    logins: Annotated[str, Query(max_length=10)] = "",
    after: Annotated[str, Query(max_length=200, pattern=SHOWN)] = "",
) -> AuditFilter:
    """Read the selection from a form, which sends an empty text for an empty field."""
    return AuditFilter(**vars(span), who=who, action=action or None, logins=logins, after=after or None)


class EntryValue(NamedTuple):
    """Value of an entry under its name in the API; `before` is None where the action did not change a value."""

    name: str
    before: str | None
    now: str


def values_of(entry: AuditEntry) -> list[EntryValue]:
    """Return the values of an entry; of a change those that differ, each with the value before."""
    detail = entry.detail or {}
    if not entry.action.endswith(("-changed", "-renamed", "-marked")):
        written = ((name, _written(value)) for name, value in detail.items() if value not in (None, []))
        return [EntryValue(name, None, text) for name, text in written if text]
    return [each for name, (before, now) in detail.items() for each in _differences(name, before, now)]


def _differences(name: str, before: object, now: object) -> Iterator[EntryValue]:
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            yield from _differences(f"{name}.{key}", before.get(key), now.get(key))
    elif before != now:
        yield EntryValue(name, None if before is None else _written(before), _written(now))


def _written(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}: {_written(part)}" for name, part in value.items() if part is not None)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
