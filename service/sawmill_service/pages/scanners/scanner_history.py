"""`/scanners/{scanner_id}/history`: measurements over months, and everything that happened, by whom and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import Depends, Query
from fastapi.responses import HTMLResponse

from sawmill_contracts import mill_events
from sawmill_contracts.calibrations import Calibration
from sawmill_contracts.drifts import Drift
from sawmill_contracts.history import HistoryEntry, HistoryKind
from sawmill_mill.alarms import ALARMS
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.charts import DEVIATIONS, MOST_LINES, Span, is_calibration, trend_chart
from sawmill_service.pages.frame.languages import Word, marked
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_service.pages.lists import Cursor, DaySpan
from sawmill_service.pages.scanners.scanner import SPANS
from sawmill_service.pages.scanners.scanner_form import FIELDS
from sawmill_store.store import Store

PER_PAGE = 50
# Labels of settings by their names in the API.
LABELS = {".".join(each.place): each.label for each in FIELDS} | {"name": marked("Name")}
KINDS = {
    HistoryKind.CALIBRATION: marked("Calibration"),
    HistoryKind.DRIFT_CHECK: marked("Drift check"),
    HistoryKind.ACTIVATION: marked("Calibration in use"),
    HistoryKind.DISCARD: marked("Discarded calibration"),
    HistoryKind.ALARM: marked("Alarm"),
    HistoryKind.SETTINGS: marked("Settings"),
    HistoryKind.SCHEDULE: marked("Schedule"),
    HistoryKind.SCAN: marked("Scan"),
}
EVENT_WORDS = {
    event_kinds.FAILED: Word("bad", marked("Failed")),
    event_kinds.CANCELLED: Word("idle", marked("Cancelled")),
    mill_events.CALIBRATION_ACTIVATED: Word("good", marked("Accepted")),
    mill_events.CALIBRATION_ROLLED_BACK: Word("watch", marked("Rolled back")),
    mill_events.CALIBRATION_DISCARDED: Word("idle", marked("Discarded")),
    mill_events.ALARM_ACKNOWLEDGED: Word("idle", marked("Acknowledged")),
    mill_events.RED_ACKNOWLEDGED: Word("idle", marked("Acknowledged")),
    mill_events.ALARM_OPENED: Word("bad", marked("Begun")),
    mill_events.ALARM_CLOSED: Word("good", marked("Ended")),
    mill_events.SCANNER_CREATED: Word("idle", marked("Added")),
    mill_events.SCANNER_CHANGED: Word("idle", marked("Changed")),
    mill_events.SCHEDULE_CREATED: Word("idle", marked("Added")),
    mill_events.SCHEDULE_CHANGED: Word("idle", marked("Changed")),
    mill_events.SCHEDULE_DELETED: Word("idle", marked("Deleted")),
    mill_events.SCHEDULE_MISSED: Word("watch", marked("Missed")),
    mill_events.SCAN_REFUSED: Word("bad", marked("Refused")),
}
VERDICTS = {
    "pass": Word("good", marked("Passed")),
    "watch": Word("watch", marked("Watch")),
    "fail": Word("bad", marked("Not usable")),
}
_DRIFTS = {
    True: Word("good", marked("Within tolerance")),
    False: Word("bad", marked("Out of tolerance")),
    None: Word("idle", marked("Not certain")),
}

router = Router(include_in_schema=False, reading=Scope.READ)


@dataclass(frozen=True)
class ShownHistory(DaySpan):
    """Selection of the entries that the page lists, and the span of the chart."""

    kind: HistoryKind | Literal[""] = ""  # empty: all kinds
    days: Annotated[float, Query(ge=0.1, le=3660)] = 365
    after: Cursor = ""  # cursor of the previous page

    def arguments(self) -> dict[str, Any]:
        """Return the selection as arguments for the store."""
        return {"kind": self.kind or None, **self.bounds()}

    def address(self, **changes: str | float | None) -> str:
        """Return the query of this page with some values changed; from the first entries on unless `after` is given."""
        query = {"kind": self.kind, "first": self.first, "last": self.last, "zone": self.zone, "days": f"{self.days:g}"}
        return "?" + urlencode({name: value for name, value in (query | changes).items() if value})

    def file_query(self) -> str:
        """Return the query for the same entries in the API's file."""
        times = {
            name: value.isoformat() if name != "kind" else value for name, value in self.arguments().items() if value
        }
        return "?" + urlencode(times) if times else ""


@router.get("/scanners/{scanner_id}/history")
def scanner_history(
    scanner_id: Identifier, page: ThePage, store: TheStore, shown: Annotated[ShownHistory, Depends()]
) -> HTMLResponse:
    """Show the whole page."""
    stored, span = store.scanners.get(scanner_id), Span.until(datetime.now(UTC), shown.days)
    movements, total = store.measurements.movements_of(scanner_id, span.start, span.end)
    marks, opened = store.history.marks(scanner_id, span.start), store.alarms.open(scanner_id=scanner_id)
    found = store.history.page(scanner_id, **shown.arguments(), after=shown.after or None, limit=PER_PAGE)
    return page.answer(
        "scanner_history.html",
        scanner=stored,
        shown=shown,
        spans=SPANS,
        chart=trend_chart(movements, marks, opened, span, total, store.drift_charts.of_scanner(scanner_id).charts),
        most_lines=MOST_LINES,
        is_calibration=is_calibration,
        deviations=DEVIATIONS,
        days=shown.days,
        found=found,
        subjects=_subjects(store, found.items),
        labels={name: page.text.gettext(label) for name, label in LABELS.items()},
        kinds=KINDS,
        word_of=word_of,
        alarms=ALARMS,
    )


def _subjects(store: Store, entries: Sequence[HistoryEntry]) -> dict[tuple[str, str], Calibration | Drift]:
    """Find the calibrations and drift checks of entries that are still stored, by their types and ids."""

    def ids(subject: str) -> set[str]:
        return {entry.subject_id for entry in entries if entry.subject == subject}

    calibrations, drifts = store.calibrations.several(ids("calibration")), store.drifts.several(ids("drift"))
    return {("calibration", id_): each for id_, each in calibrations.items()} | {
        ("drift", id_): each for id_, each in drifts.items()
    }


def word_of(entry: HistoryEntry) -> Word:
    """Return the outcome of an entry, in a word with its colour."""
    measured = entry.measured
    if measured is None:
        return EVENT_WORDS.get(entry.type) or Word("idle", entry.type)
    return _DRIFTS[measured.within_tolerance] if measured.verdict is None else VERDICTS[measured.verdict]
