"""`/`: the condition of all scanners, the worst first, kept up to date while the page is open."""

import gettext
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from fastapi.responses import HTMLResponse

from sawmill_contracts import mill_events
from sawmill_contracts.measurements import Movement
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import EventKind
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore, TheStreamTimes
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.charts.sparkline import Sparkline, sparkline
from sawmill_service.pages.frame.page_frame import (
    PageFrame,
    ThePage,
)
from sawmill_service.scanner_conditions import ScannerCondition, conditions_of
from sawmill_store.store import Store

SPAN = timedelta(days=30)
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
    def rank(self) -> tuple[int, float, str]:
        """Key for sorting: the worst comes first; among equals the scanner that has moved farthest."""
        moved = self.condition.state.moved
        share = moved.share if moved is not None and moved.since_active else 0.0
        return _WORST_FIRST.index(self.condition.step.tone), -share, self.condition.scanner.name


@dataclass(frozen=True)
class Board:
    """Part of the page that changes: all scanners, the number of them that need somebody, and the time of the state."""

    rows: Sequence[ScannerLine]
    needy: int
    headline: str
    now: datetime


@router.get("/")
def today(page: ThePage, store: TheStore, times: TheStreamTimes) -> HTMLResponse:
    """Show the whole page; its script follows the events after the number that was read before the rows."""
    number = store.events.reader().number
    kinds = " ".join(kind for kind in EventKind.published() if kind not in _NOT_SHOWN)
    return page.answer(
        "today.html",
        board=_board(page, store),
        alarms=ALARMS,
        number=number,
        kinds=kinds,
        lost_ms=round(1000 * times.lost_s),
        silent_ms=round(1000 * times.silent_s),
    )


@router.get("/today/rows")
def rows(page: ThePage, store: TheStore) -> HTMLResponse:
    """Return the part of the page that changes."""
    return page.answer("today_rows.html", board=_board(page, store), alarms=ALARMS)


def _board(page: PageFrame, store: Store) -> Board:
    now = store.now()
    movements = store.measurements.movements(now - SPAN, now)
    scanners = [_row(condition, movements, now) for condition in conditions_of(store)]
    needy = sum(row.condition.step.needs_somebody for row in scanners)
    return Board(sorted(scanners, key=lambda row: row.rank), needy, _headline(page.text, len(scanners), needy), now)


def _row(condition: ScannerCondition, movements: Mapping[str, Sequence[Movement]], now: datetime) -> ScannerLine:
    scanner = condition.scanner
    return ScannerLine(condition, sparkline(movements.get(scanner.id, ()), scanner.tolerances, now - SPAN, now))


def _headline(text: gettext.NullTranslations, scanners: int, needy: int) -> str:
    fine = scanners - needy
    if not scanners:
        return text.gettext("There is no scanner yet")
    if not needy:
        return text.ngettext("The scanner is fine", "All %(fine)s scanners are fine", fine) % {"fine": fine}
    both = text.ngettext("%(fine)s fine, %(needy)s needs you", "%(fine)s fine, %(needy)s need you", needy)
    return both % {"fine": fine, "needy": needy}
