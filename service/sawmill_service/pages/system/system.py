"""Page of the system: disk, workers, database, clock, limits; for administrators keys, and the audit as a page."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, NamedTuple
from urllib.parse import urlencode

from fastapi import Depends, Query, Request
from fastapi.responses import HTMLResponse, RedirectResponse

from sawmill_contracts import mill_events
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.event_kinds import EventType
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import ThePage
from sawmill_service.pages.lists import Cursor, DaySpan
from sawmill_service.pages.system.system_parts import CLOCK_EVENTS, Queue, disk_of, limits_of, versions, workers_of
from sawmill_service.routes.health import Readiness, broker_of, health_of

PER_PAGE = 50
# Each morning has many; they are shown on request.
_LOGINS = (event_kinds.LOGGED_IN, event_kinds.LOGGED_OUT)


@dataclass(frozen=True)
class AuditFilter(DaySpan):
    """Selection of the entries that the page lists."""

    who: Annotated[str, Query(max_length=200)] = ""  # name of the actor; empty: everybody
    action: EventType | Literal[""] = ""  # kind of the action; empty: all kinds
    logins: Annotated[str, Query(max_length=10)] = ""  # not empty: log-ins and log-outs too
    after: Cursor = ""  # cursor of the previous page

    def arguments(self) -> dict[str, Any]:
        """Return the selection as arguments for the audit."""
        return {
            "who": self.who or None,
            "action": self.action or None,
            "without": () if self.logins or self.action in _LOGINS else _LOGINS,
            "after": self.after or None,
            **self.bounds(),
        }

    def address(self, after: str | None = None) -> str:
        """Return the query of this page from the first entry on, or from a cursor on."""
        return "?" + urlencode({name: value for name, value in (vars(self) | {"after": after}).items() if value})


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


SYSTEM = "/system"
SCOPES = {
    Scope.READ: marked("may look"),
    Scope.SUBMIT: marked("may also upload and ask for work"),
    Scope.ACTIVATE: marked("may also decide what a scanner uses"),
    Scope.ADMIN: marked("may do everything"),
}
STATES = {
    Readiness.READY: ("good", marked("Ready")),
    Readiness.WITHOUT_WORKER: ("watch", marked("No worker")),
    Readiness.DISK_FULL: ("bad", marked("Disk full")),
}
ACTIONS = {
    mill_events.CALIBRATION_ACTIVATED: marked("accepted the calibration"),
    mill_events.CALIBRATION_ROLLED_BACK: marked("rolled back to the calibration"),
    mill_events.CALIBRATION_DISCARDED: marked("discarded the calibration"),
    mill_events.ALARM_ACKNOWLEDGED: marked("acknowledged an alarm of the scanner"),
    mill_events.RED_ACKNOWLEDGED: marked("knows why this scanner is red:"),
    mill_events.TIME_ZONE_SET: marked("set the time zone of"),
    mill_events.SCANNER_CREATED: marked("added the scanner"),
    mill_events.SCANNER_CHANGED: marked("changed the scanner"),
    mill_events.SCANNER_DELETED: marked("deleted the scanner"),
    mill_events.PHANTOM_DELETED: marked("deleted the phantom"),
    mill_events.SCAN_DELETED: marked("deleted the scan"),
    mill_events.RECONSTRUCTION_RENAMED: marked("renamed the log"),
    mill_events.RECONSTRUCTION_MARKED: marked("measured in the log"),
    mill_events.INSPECTION_DELETED: marked("deleted the file that was looked into"),
    mill_events.SCHEDULE_CREATED: marked("added the schedule"),
    mill_events.SCHEDULE_CHANGED: marked("changed the schedule"),
    mill_events.SCHEDULE_DELETED: marked("deleted the schedule"),
    event_kinds.JOB_CANCELLED: marked("cancelled the job"),
    event_kinds.KEY_CREATED: marked("made the key"),
    event_kinds.KEY_ROTATED: marked("gave a new secret to the key"),
    event_kinds.KEY_REVOKED: marked("revoked the key"),
    event_kinds.WEBHOOK_CREATED: marked("added the webhook"),
    event_kinds.WEBHOOK_CHANGED: marked("changed the webhook"),
    event_kinds.WEBHOOK_ROTATED: marked("gave a new secret to the webhook"),
    event_kinds.WEBHOOK_TESTED: marked("sent a test to the webhook"),
    event_kinds.WEBHOOK_DELETED: marked("deleted the webhook"),
    event_kinds.RETENTION_CHANGED: marked("changed how long things are kept"),
    event_kinds.LOGGED_IN: marked("logged in with"),
    event_kinds.LOGGED_OUT: marked("logged out of"),
}

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get(SYSTEM)
def system(request: Request, page: ThePage, store: TheStore, settings: TheSettings) -> HTMLResponse:
    """Show the page, with keys for administrators alone."""
    admin, now, stored = page.may(Scope.ADMIN), datetime.now(UTC), store.settings
    return page.answer(
        "system.html",
        health=health_of(store, request.app.state.broker_url),
        states=STATES,
        queue=Queue(store.places.waiting(), stored.max_queued_jobs, stored.max_queued_jobs_per_key),
        disk=disk_of(store.scans, store.settings),
        workers=workers_of(store.events, store.jobs, page, now),
        database=store.database_report(),
        broker=broker_of(request.app.state.broker_url),
        clock_off_s=store.clock_off_s(),
        clock=store.events.of_clock()[::-1][:CLOCK_EVENTS],
        versions=versions(),
        limits=limits_of(settings, store.settings),
        keys=store.keys.all() if admin else None,
        scopes=SCOPES,
        now=now,
    )


@router.get(f"{SYSTEM}/keys")
def keys() -> RedirectResponse:
    """Lead to the page's part with the keys."""
    return RedirectResponse(f"{SYSTEM}#keys")


@router.get("/audit", needs=Scope.ADMIN)
def audit(page: ThePage, store: TheStore, shown: Annotated[AuditFilter, Depends()]) -> HTMLResponse:
    """Show who did what, the newest first, with a filter."""
    return page.answer(
        "audit.html",
        shown=shown,
        found=store.audit.page(**shown.arguments(), limit=PER_PAGE),
        actors=store.audit.actors(),
        actions=ACTIONS,
        values_of=values_of,
    )
