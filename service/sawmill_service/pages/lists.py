"""Common part of the lists of scans and logs: a filter by scanner and day, kept in the address, and the next page."""

from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from typing import Annotated, Any
from urllib.parse import urlencode
from zoneinfo import ZoneInfo

from fastapi import Depends, Query

from sawmill_service.http.problems import Refused
from sawmill_store.scans.phantoms import Phantoms

PER_PAGE = 24
# Days far from today have no moment in some time zones.
_YEARS = range(1970, 2200)
_MOST_NAMES = 200


@dataclass(frozen=True)
class ListFilter:
    """Filter of the items in a list."""

    scanner_id: str  # id of a scanner; empty: all scanners
    day: date | None  # day on which the items were made
    zone: str  # time zone of the day, as Europe/Helsinki; empty: the zone of this machine
    after: str | None  # cursor of the previous page

    def arguments(self) -> dict[str, Any]:
        """Return the filter as arguments for the store's pages."""
        arguments: dict[str, Any] = {"scanner_id": self.scanner_id or None, "after": self.after, "limit": PER_PAGE}
        if self.day is not None:
            start, end = day_of(self.day, self.zone)
            arguments |= {"created_from": start, "created_before": end}
        return arguments

    def address(self, after: str | None = None) -> str:
        """Return the query of this filter, from its first page on or from a cursor on."""
        query = {"scanner_id": self.scanner_id, "day": self.day or "", "zone": self.zone, "after": after or ""}
        return "?" + urlencode({name: value for name, value in query.items() if value})


_ONE_DAY = timedelta(days=1)
SHOWN = "^[!-~]*$"  # characters of an id, or of a cursor


def _list_filter(
    scanner_id: Annotated[str, Query(max_length=64, pattern=SHOWN)] = "",
    day: Annotated[str, Query(max_length=20)] = "",
    zone: Annotated[str, Query(max_length=64)] = "",
    after: Annotated[str, Query(max_length=200, pattern=SHOWN)] = "",
) -> ListFilter:
    """Read the filter from a form, which sends an empty text for an empty field."""
    return ListFilter(scanner_id, parse_day("day", day), check_zone(zone), after or None)


TheFilter = Annotated[ListFilter, Depends(_list_filter)]


@dataclass(frozen=True)
class DaySpan:
    """Span of days in a filter."""

    # first, last: first and last day.
    first: date | None
    last: date | None
    zone: str  # time zone of these days; empty: this machine's

    def bounds(self) -> dict[str, datetime | None]:
        """Return the span as arguments for the store."""
        since = None if self.first is None else day_of(self.first, self.zone)[0]
        return {"since": since, "until": None if self.last is None else day_of(self.last, self.zone)[1]}


def _day_span(
    first: Annotated[str, Query(max_length=20)] = "",
    last: Annotated[str, Query(max_length=20)] = "",
    zone: Annotated[str, Query(max_length=64)] = "",
) -> DaySpan:
    """Read the days from a form, which sends an empty text for an empty field."""
    return DaySpan(parse_day("first", first), parse_day("last", last), check_zone(zone))


TheSpan = Annotated[DaySpan, Depends(_day_span)]


def parse_day(name: str, text: str) -> date | None:
    """Parse the day in a field of this name; None where the field is empty."""
    if not text:
        return None
    try:
        day = date.fromisoformat(text)
    except ValueError:
        day = None
    if day is None or day.year not in _YEARS:
        raise Refused(422, "invalid-day", f"{name} must be a date such as 2026-03-01, not {text!r}")
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


def phantom_names(phantoms: Phantoms) -> dict[str, str]:
    """Return the names of phantoms by their ids."""
    return {phantom.id: phantom.name for phantom in phantoms.page(limit=_MOST_NAMES).items}
