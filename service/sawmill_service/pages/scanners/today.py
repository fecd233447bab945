"""`/`: the condition of all scanners, the worst first, kept up to date while the page is open."""

import gettext
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated

from fastapi import Depends, Query
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_contracts import mill_events
from sawmill_contracts.measurements import Movement
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore, TheStreamTimes
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.charts import Span, Sparkline, sparkline
from sawmill_service.pages.frame.languages import natural_order
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.scanner_conditions import ScannerCondition, conditions_of
from sawmill_store.examples import is_example, remove_examples
from sawmill_store.store import Store

SPAN = timedelta(days=30)
# From this number of scanners on, rows are compact, and equal states share a tile.
COMPACT_FROM = 8
# Most tiles below one another on a wall.
LONGEST_COLUMN = 9
_WORST_FIRST = ("bad", "watch", "idle", "good")
# Events that no row of a scanner shows.
_NOT_SHOWN = {
    event_kinds.CLOCK_OFF,
    event_kinds.CLOCK_STEPPED,
    event_kinds.CANCEL_REQUESTED,
    mill_events.INSPECTION_DELETED,
    event_kinds.UPLOAD_CREATED,
    event_kinds.UPLOAD_COMPLETE,
    event_kinds.UPLOAD_USED,
    event_kinds.UPLOAD_DELETED,
    event_kinds.KEY_CREATED,
    event_kinds.KEY_ROTATED,
    event_kinds.KEY_REVOKED,
    event_kinds.WEBHOOK_CREATED,
    event_kinds.WEBHOOK_CHANGED,
    event_kinds.WEBHOOK_ROTATED,
    event_kinds.WEBHOOK_TESTED,
    event_kinds.WEBHOOK_PAUSED,
    event_kinds.WEBHOOK_DELETED,
}

router = Router(include_in_schema=False, reading=Scope.READ)


@dataclass(frozen=True)
class ScannerLine:
    """A scanner of the page."""

    condition: ScannerCondition
    movements: Sparkline | None

    @property
    def example(self) -> bool:
        """Whether it is an example, which needs nobody."""
        return is_example(self.condition.scanner)

    @property
    def needs_somebody(self) -> bool:
        """Whether a person must do something."""
        return not self.example and self.condition.step.needs_somebody and self.condition.known is None

    @property
    def group(self) -> str:
        """List of a board of many scanners: `fine`, `grey` (without a calibration), or `scanners`, each with a row."""
        return {"good": "fine", "idle": "grey"}.get("" if self.example else self.condition.step.tone, "scanners")

    @property
    def rank(self) -> tuple[bool, int, float, list[str | int]]:
        """Key for sorting: the worst comes first, among equals the scanner that has moved farthest; examples last."""
        moved = self.condition.state.moved
        share = moved.share if moved is not None and moved.since_active else 0.0
        name = natural_order(self.condition.scanner.name)
        return self.example, _WORST_FIRST.index(self.condition.step.tone), -share, name


@dataclass(frozen=True)
class Board:
    """Part of the page that changes: all scanners, the worst first, at a time; `kiosk` is for a display on the wall.

    At `changes_at` the first acknowledgement of an alarm ends, which no event tells.
    """

    rows: Sequence[ScannerLine]
    title: str
    headline: str
    now: datetime
    changes_at: datetime | None
    kiosk: bool

    @property
    def empty(self) -> bool:
        """Whether there is no scanner but examples."""
        return all(row.example for row in self.rows)

    @property
    def compact(self) -> bool:
        """Whether rows must be small, because there are many scanners."""
        return len(self.rows) >= COMPACT_FROM

    def group(self, name: str) -> Sequence[ScannerLine]:
        """Return the rows of a group of equal states, which share a tile where there are many scanners."""
        return [row for row in self.rows if self.compact and row.group == name]

    @property
    def shown(self) -> Sequence[ScannerLine]:
        """Rows that are in sight at once."""
        return self.group("scanners") if self.compact else self.rows

    @property
    def tiles(self) -> int:
        """Number of tiles on a wall."""
        return max(len(self.shown) + bool(self.group("fine")) + bool(self.group("grey")), 1)

    @property
    def columns(self) -> int:
        """Number of columns of tiles on a wall, so that none is longer than can be read."""
        return -(-self.tiles // LONGEST_COLUMN)


def _is_kiosk(kiosk: Annotated[str | None, Query(max_length=10)] = None) -> bool:
    """Return whether the address asks for the view of a display on the wall, as in `/?kiosk`."""
    return kiosk is not None


ForKiosk = Annotated[bool, Depends(_is_kiosk)]


@router.get("/")
def today(page: ThePage, store: TheStore, times: TheStreamTimes, kiosk: ForKiosk) -> HTMLResponse:
    """Show the whole page; its script follows the events after the number that was read before the rows."""
    number = store.events.reader().number
    return page.answer(
        "today.html",
        board=_board(page, store, kiosk=kiosk),
        alarms=ALARMS,
        number=number,
        kinds=" ".join(kind for kind in EventType.published() if kind not in _NOT_SHOWN),
        lost_ms=round(1000 * times.lost_s),
        silent_ms=round(1000 * times.silent_s),
    )


@router.get("/today/rows")
def rows(page: ThePage, store: TheStore, kiosk: ForKiosk) -> HTMLResponse:
    """Return the part of the page that changes."""
    return page.answer("today_rows.html", board=_board(page, store, kiosk=kiosk), alarms=ALARMS)


@router.post("/examples/delete", needs=Scope.ADMIN)
def delete_examples(store: TheStore) -> RedirectResponse:
    """Remove the examples and return to the page."""
    remove_examples(store)
    return RedirectResponse("/", status_code=303)


def _board(page: PageFrame, store: Store, *, kiosk: bool) -> Board:
    now = store.now()
    movements = store.measurements.movements(now - SPAN, now)
    rows = [_row(condition, movements, now) for condition in conditions_of(store)]
    needy = [row.condition.step.tone for row in rows if row.needs_somebody]
    red, others = needy.count("bad"), len(needy) - needy.count("bad")
    known = [row.condition.known for row in rows if row.condition.known is not None]
    fine = sum(row.group == "fine" for row in rows)
    ends = [notice.until for notice in known] + [
        alarm.acknowledged.until
        for row in rows
        for alarm in row.condition.alarms
        if alarm.acknowledged is not None and alarm.kind in row.condition.acknowledged
    ]
    return Board(
        rows=sorted((row for row in rows if not (kiosk and row.example)), key=lambda row: row.rank),
        title=_title(page.text, red, others),
        headline=_headline(page.text, fine, red, others, len(known)),
        now=now,
        changes_at=min(ends, default=None),
        kiosk=kiosk,
    )


def _row(condition: ScannerCondition, movements: Mapping[str, Sequence[Movement]], now: datetime) -> ScannerLine:
    scanner = condition.scanner
    return ScannerLine(condition, sparkline(movements.get(scanner.id, ()), scanner.tolerances, Span(now - SPAN, now)))


def _title(text: gettext.NullTranslations, red: int, others: int) -> str:
    """Write the page's name, before it the red scanners and the others that need somebody, for a tab at the side."""
    if not red:
        return (f"({others}) " if others else "") + text.gettext("Today")
    count = text.gettext("%(red)s red + %(others)s") if others else text.gettext("%(red)s red")
    return f"({count % {'red': red, 'others': others}}) " + text.gettext("Today")


def _headline(text: gettext.NullTranslations, fine: int, red: int, others: int, known: int) -> str:
    needy = red + others
    if not fine + needy + known:
        return text.gettext("There is no scanner yet")
    if known and not needy:
        both = text.ngettext("%(fine)s fine, %(known)s red and known", "%(fine)s fine, %(known)s red and known", known)
        return both % {"fine": fine, "known": known}
    if not needy:
        return text.ngettext("The scanner is fine", "All %(fine)s scanners are fine", fine) % {"fine": fine}
    both = text.ngettext("%(fine)s fine, %(needy)s needs you", "%(fine)s fine, %(needy)s need you", needy)
    if red and others:
        both += text.gettext(", %(red)s of them red")
    if known:
        both += text.gettext(", %(known)s red and known")
    return both % {"fine": fine, "needy": needy, "red": red, "known": known}
