"""Languages of the pages: catalogues, a browser's language, and numbers, times and states in its words."""

import gettext
import io
import math
import re
from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from babel import Locale, negotiate_locale
from babel.dates import format_date, format_skeleton, format_time, format_timedelta, get_datetime_format
from babel.messages.catalog import Catalog
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po
from babel.numbers import format_decimal, format_scientific

from sawmill_contracts.scans import ScanState
from sawmill_platform.contracts.jobs import JobState
from sawmill_vocabulary import ColorMap
from sawmill_vocabulary.messages import N_, Reader

_CATALOGUES = Path(__file__).parents[2] / "locale"
ENGLISH = "en"


class Language(StrEnum):
    """Languages of the report."""

    ENGLISH = ENGLISH
    FINNISH = "fi"


# Names of the languages in the languages themselves, so that readers recognise their own.
LANGUAGES = {ENGLISH: "English", "fi": "Suomi"}
# Locales whose dates, hours and decimals are used for a language.
_REGIONS = {ENGLISH: "en_GB"}
marked = N_


def catalogue(language: str) -> Catalog:
    """Read the translations into a language other than English."""
    with (_CATALOGUES / language / "LC_MESSAGES" / "sawmill.po").open("rb") as file:
        return read_po(file, locale=language)


@cache
def texts(language: str) -> gettext.NullTranslations:
    """Return the catalogue of a language; English needs none, because the pages are written in it."""
    if language == ENGLISH:
        return gettext.NullTranslations()
    compiled = io.BytesIO()
    write_mo(compiled, catalogue(language))
    compiled.seek(0)
    return gettext.GNUTranslations(compiled)


def locale_of(language: str) -> Locale:
    """Return the locale by which a language writes dates and numbers."""
    return Locale.parse(_REGIONS.get(language, language))


def preferred_language(chosen: str, accepted: str) -> str:
    """Choose the language of the answer."""
    if chosen in LANGUAGES:
        return chosen
    by_weight = sorted((_weighed(part) for part in accepted.split(",")[:20]), reverse=True)
    return negotiate_locale([name for weight, name in by_weight if weight > 0.0], LANGUAGES, sep="-") or ENGLISH


def _weighed(part: str) -> tuple[float, str]:
    name, _, parameter = part.partition(";")
    try:
        weight = float(parameter.strip().removeprefix("q=") or 1.0)
    except ValueError:  # no weight of the standard: the language is not accepted
        weight = 0.0
    return weight, name.strip().lower()


_BINARY = ("B", "KiB", "MiB", "GiB", "TiB")
# Babel cannot write the last digits of a larger number.
_LARGEST_IN_FULL = 1e15


class Formats:
    """Numbers and times in one language; an unknown value (None, or not finite) is written as unknown."""

    def __init__(self, locale: Locale, text: gettext.NullTranslations, zone: str | None = None) -> None:
        self._locale = locale
        self._text = text
        self._zone = zone  # time zone in which times are written; None: this machine's

    @property
    def reader(self) -> Reader:
        """The language, for messages."""
        return Reader(self._text.gettext, self.number, self._locale.language)

    def filters(self) -> dict[str, Callable[..., Any]]:
        """Return the formats by the names that templates use."""
        return {
            "number": self.number,
            "mm": self.mm,
            "percent": self.percent,
            "share": self.share,
            "log_mm": self.log_mm,
            "degrees": self.degrees,
            "bytes": self.bytes,
            "moment": self.moment,
            "day": self.day,
            "axis": self.axis,
            "age": self.age,
            "significant": self.significant,
            "iso": iso,
            "known_zone": known_zone,
        }

    def number(self, value: float | None, digits: int = 0, *, signed: bool = False) -> str:
        """Write a number rounded to `digits` decimals; `signed` writes the plus too."""
        if value is None or not math.isfinite(value):
            return self._text.gettext("not known")
        if abs(value) >= _LARGEST_IN_FULL:
            return str(format_scientific(value, locale=self._locale))
        pattern = "#,##0" + ("." + "0" * digits if digits else "")
        return format_decimal(value, f"+{pattern};-{pattern}" if signed else pattern, locale=self._locale)

    def significant(self, value: float, digits: int) -> str:
        """Write a number with this number of significant digits, a very small or large one with its exponent."""
        return self.reader.localised(f"{value:.{digits}g}")

    def mm(self, value: float | None, digits: int = 3, *, signed: bool = False) -> str:
        """Write a length, mm."""
        return self._with_unit(value, digits, "mm", signed=signed)

    def percent(self, value: float | None, digits: int = 2, *, signed: bool = False) -> str:
        """Write a value that is in per cent already."""
        return self._with_unit(value, digits, "%", signed=signed)

    def share(self, value: float | None) -> str:
        """Write a value in per cent to two significant digits."""
        return self._with_unit(value, _two_digits(value), "%", signed=False)

    def log_mm(self, value: float | None) -> str:
        """Write a length on a log: to two significant digits below 10 mm, to one mm above."""
        return self._with_unit(value, _two_digits(value), "mm", signed=False)

    def degrees(self, value_deg: float | None, digits: int = 3, *, signed: bool = False) -> str:
        """Write an angle that is in degrees already."""
        return self._with_unit(value_deg, digits, "°", signed=signed)

    def bytes(self, value: float | None) -> str:
        """Write a number of bytes with a binary prefix."""
        if value is None:
            return self._text.gettext("not known")
        step = min(len(_BINARY) - 1, max(0, int(math.log2(max(value, 1)) // 10)))
        return f"{self.number(value / 1024**step, 1 if step else 0)} {_BINARY[step]}"

    def moment(self, time: datetime | str | None, zone: str | None = None) -> str:
        """Write day and minute, in the zone of the mill or in another one."""
        if time is None:
            return self._text.gettext("never")
        return str(get_datetime_format("medium", self._locale)).format(self.hour(time, zone), self.day(time, zone))

    def hour(self, time: datetime | str, zone: str | None = None) -> str:
        """Write hour and minute alone, in the zone of the mill or in another one."""
        return str(format_time(_local(time, zone or self._zone), "short", locale=self._locale))

    def day(self, time: datetime | str | None, zone: str | None = None) -> str:
        """Write the day alone, in the zone of the mill or in another one."""
        return (
            self._text.gettext("never")
            if time is None
            else format_date(_local(time, zone or self._zone), "medium", self._locale)
        )

    def axis(self, time: datetime, *, with_year: bool = False) -> str:
        """Write day and month, or month and year, for an axis; the hour where the time is not midnight."""
        if time.hour or time.minute:
            return str(format_time(_local(time, self._zone), "short", locale=self._locale))
        return str(format_skeleton("yMMM" if with_year else "MMMd", _local(time, self._zone), locale=self._locale))

    def age(self, time: datetime | str | None) -> str:
        """Write how long ago a time was, or how far ahead it is."""
        if time is None:
            return self._text.gettext("never")
        ago = _local(time) - datetime.now(UTC)
        return format_timedelta(ago, granularity="second", add_direction=True, locale=self._locale)

    def _with_unit(self, value: float | None, digits: int, unit: str, *, signed: bool) -> str:
        written = self.number(value, digits, signed=signed)
        if value is None or not math.isfinite(value):
            return written
        return f"{written}{unit}" if unit == "°" else f"{written}\N{NO-BREAK SPACE}{unit}"


def plain_number(typed: str) -> str:
    """Return a typed number without spaces and with a decimal point: people type a comma or a point in any language."""
    return "".join(typed.split()).replace(",", ".")


def natural_order(name: str) -> list[str | int]:
    """Return a key for sorting names as people count: Line 2 comes before Line 10."""
    return [int(part) if place % 2 else part for place, part in enumerate(re.split(r"([0-9]+)", name.casefold()))]


def iso(time: datetime | str) -> str:
    """Write a time for programs (RFC 3339)."""
    return time if isinstance(time, str) else time.isoformat()


def known_zone(name: str) -> str:
    """Return the time zone of that name, or UTC where this machine's tz database, an older one, does not have it."""
    try:
        ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError):
        return "UTC"
    return name


def _local(time: datetime | str, zone: str | None = None) -> datetime:
    moment = datetime.fromisoformat(time) if isinstance(time, str) else time
    return moment.astimezone(None if zone is None else ZoneInfo(zone))


def _two_digits(value: float | None) -> int:
    """Return the number of decimals that leaves two significant digits, for values from 0.1 on."""
    return 0 if value is None or value >= 9.95 else 1 if value >= 0.995 else 2


class Word(NamedTuple):
    """Word for a state, and the name of a colour."""

    tone: str
    word: str


SCAN_STATES = {
    ScanState.INGESTING: Word("busy", marked("Being read")),
    ScanState.READY: Word("good", marked("Ready")),
    ScanState.REFUSED: Word("bad", marked("Refused")),
}
LOG_STATES = {
    JobState.QUEUED: Word("idle", marked("Waiting")),
    JobState.RUNNING: Word("busy", marked("Computing")),
    JobState.SUCCEEDED: Word("good", marked("Ready")),
    JobState.FAILED: Word("bad", marked("Failed")),
    JobState.CANCELLED: Word("idle", marked("Cancelled")),
}
COLOR_MAPS = {
    ColorMap.GREY: marked("Grey"),
    ColorMap.VIRIDIS: marked("Viridis"),
    ColorMap.INFERNO: marked("Inferno"),
    ColorMap.MAGMA: marked("Magma"),
}
