"""Common part of the lists of scans and logs: a filter by scanner and day, kept in the address, and the next page."""

from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode
from zoneinfo import ZoneInfo

from fastapi import Depends, Query
from pydantic import AfterValidator, BeforeValidator

from sawmill_service.http.problems import Refused
from sawmill_store.scans.phantoms import Phantoms

PER_PAGE = 24
# Days far from today have no moment in some time zones.
_YEARS = range(1970, 2200)
_MOST_NAMES = 200
_ONE_DAY = timedelta(days=1)
_SHOWN = "^[!-~]*$"  # characters of an id, or of a cursor


def _day(name: str, text: str) -> date | None:
    """Parse the day in a field of this name; None where the field is empty."""
    if not text:
        return None
    try:
        day = date.fromisoformat(text)
    except ValueError:
        day = None
    if day is None or day.year not in _YEARS:
        raise Refused(422, "invalid-day", f"{name} must be a date such as 2026-03-01, not {text[:100]!r}")
    return day


def day_of(day: date, zone: str) -> tuple[datetime, datetime]:
    """Return the first moments of a day and of the next, in a time zone or, where that is empty, in this machine's."""

    def midnight(date: date) -> datetime:
        start = datetime.combine(date, time.min)
        return start.replace(tzinfo=ZoneInfo(zone)) if zone else start.astimezone()

    return midnight(day), midnight(day + _ONE_DAY)


def check_zone(text: str) -> str:
    """Check the name of a time zone, which may be empty."""
    try:
        return text and ZoneInfo(text).key
    except (ValueError, LookupError, OSError) as error:
        raise Refused(422, "invalid-zone", f"zone must be a time zone such as Europe/Helsinki, not {text!r}") from error


# Fields of a filter, as a form sends them: an empty text for an empty field.
Zone = Annotated[str, Query(max_length=64), AfterValidator(check_zone)]
Cursor = Annotated[str, Query(max_length=200, pattern=_SHOWN)]


@dataclass(frozen=True)
class ListFilter:
    """Filter of the items in a list."""

    scanner_id: Annotated[str, Query(max_length=64, pattern=_SHOWN)] = ""  # id of a scanner; empty: all scanners
    day: Annotated[date | None, Query(), BeforeValidator(partial(_day, "day"))] = None  # day of the items' creation
    zone: Zone = ""  # time zone of the day, as Europe/Helsinki; empty: the zone of this machine
    after: Cursor = ""  # cursor of the previous page

    def arguments(self) -> dict[str, Any]:
        """Return the filter as arguments for the store's pages."""
        arguments: dict[str, Any] = {
            "scanner_id": self.scanner_id or None,
            "after": self.after or None,
            "limit": PER_PAGE,
        }
        if self.day is not None:
            start, end = day_of(self.day, self.zone)
            arguments |= {"created_from": start, "created_before": end}
        return arguments

    def address(self, after: str | None = None) -> str:
        """Return the query of this filter, from its first page on or from a cursor on."""
        return "?" + urlencode({name: value for name, value in (vars(self) | {"after": after}).items() if value})


TheFilter = Annotated[ListFilter, Depends()]


@dataclass(frozen=True)
class DaySpan:
    """Span of days in a filter."""

    # first, last: first and last day.
    first: Annotated[date | None, Query(), BeforeValidator(partial(_day, "first"))] = None
    last: Annotated[date | None, Query(), BeforeValidator(partial(_day, "last"))] = None
    zone: Zone = ""  # time zone of these days; empty: this machine's

    def bounds(self) -> dict[str, datetime | None]:
        """Return the span as arguments for the store."""
        since = None if self.first is None else day_of(self.first, self.zone)[0]
        return {"since": since, "until": None if self.last is None else day_of(self.last, self.zone)[1]}


def phantom_names(phantoms: Phantoms) -> dict[str, str]:
    """Return the names of phantoms by their ids."""
    return {phantom.id: phantom.name for phantom in phantoms.page(limit=_MOST_NAMES).items}
