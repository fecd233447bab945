"""Conditions of scanners, read from the store for pages and metrics."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from itertools import chain

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.calibrations import CalibrationSucceeded, CalibrationUnfinished
from sawmill_contracts.drifts import Drift
from sawmill_contracts.history import HistoryKind
from sawmill_contracts.next_steps import KnownRed
from sawmill_contracts.scanners import StoredScanner
from sawmill_mill.alarms import is_acknowledged
from sawmill_mill.next_step import NextStep, next_step, other_step
from sawmill_mill.scanner_state import Calibrated, Checked, ScannerState
from sawmill_platform.contracts.jobs import Failure
from sawmill_platform.errors import NotFound
from sawmill_store.scanners.overviews import Overview
from sawmill_store.store import Store

SHOWN_SCANNERS = 200  # more than any mill has


@dataclass(frozen=True)
class ScannerCondition:
    """Condition of one scanner, as pages show it.

    `newest` is the newest calibration that succeeded, ended after the last acceptance and was not discarded, else the
    one in use; `red` is the newest of these that shows the scanner red; `failed` is a newer one that failed; `active`
    is in use; `drift` is the newest drift check that succeeded or failed, `seen` the newest that could tell whether it
    has moved since `active`. `alarms` are those that are open. `discarded_at` is when a calibration was last discarded
    since the last acceptance. `noticed` is the newest notice of a red that has not ended. `step` is what a person does
    next.
    """

    scanner: StoredScanner
    newest: CalibrationSucceeded | None
    red: CalibrationSucceeded | None
    active: CalibrationSucceeded | None
    failed: CalibrationUnfinished | None
    drift: Drift | None
    seen: Drift | None
    scanned: bool
    calibrating: bool
    alarms: tuple[Alarm, ...]
    acknowledged: frozenset[AlarmKind]
    discarded_at: datetime | None
    noticed: KnownRed | None

    @property
    def failure(self) -> Failure | None:
        """Why the newest calibration failed; None where it did not, or somebody has decided since."""
        return None if self.failed is None else self.failed.failure

    @cached_property
    def state(self) -> ScannerState:
        """The facts that decide the next step."""
        failure = self.failure
        return ScannerState(
            newest=_calibrated(self.newest),
            active_id=self.scanner.active_calibration_id,
            tolerances=self.scanner.tolerances,
            failure=None if failure is None else failure.detail,
            last_check=_checked(self.drift),
            seen=_checked(self.seen),
            scanned=self.scanned,
            imported=self.scanner.imported_theta is not None,
            alarms=tuple(alarm.kind for alarm in self.alarms if alarm.kind not in self.acknowledged),
            red=_calibrated(self.red),
        )

    @cached_property
    def step(self) -> NextStep:
        """The next step with the scanner, and with its newest calibration."""
        return next_step(self.state)

    @property
    def red_results(self) -> frozenset[str]:
        """Ids of the results that show the scanner red; empty where it is not red."""
        if self.step.tone != "bad":
            return frozenset()
        fails = self.newest is not None and self.newest.verdict_on_rays == "fail"
        beyond = self.seen is not None and self.seen.result is not None and not self.seen.result.within_tolerance
        failed = self.failed if self.newest is None else None
        shown = (self.newest if fails else None, self.red, self.seen if beyond else None, failed)
        return frozenset(each.id for each in shown if each is not None)

    @property
    def known(self) -> KnownRed | None:
        """The notice that somebody took of all that shows the scanner red; None where something newer does."""
        results = self.red_results
        return self.noticed if self.noticed is not None and results and results <= self.noticed.results else None

    def step_with(self, calibration: CalibrationSucceeded, *, discarded: bool) -> NextStep:
        """Return the next step with one of the scanner's calibrations."""
        newest, active = self.newest, self.scanner.active_calibration_id == calibration.id
        if newest is not None and newest.id == calibration.id:
            return self.step
        newest_at = calibration.created_at if newest is None else newest.created_at
        return other_step(calibration.created_at, newest_at, active=active, discarded=discarded)


def _calibrated(calibration: CalibrationSucceeded | None) -> Calibrated | None:
    return None if calibration is None else Calibrated(calibration.id, calibration.created_at, calibration)


def _checked(check: Drift | None) -> Checked | None:
    if check is None:
        return None
    known, result = (check.created_at, check.calibration_id), check.result
    if result is None:
        return Checked(*known, within_tolerance=None)
    return Checked(*known, result.within_tolerance, result.ray_change_mm, result.tolerance_mm, result.explanation)


def conditions_of(store: Store) -> list[ScannerCondition]:
    """Return the conditions of all scanners, newest first, by a fixed number of statements."""
    return _conditions(store, store.overviews.read(limit=SHOWN_SCANNERS), store.alarms.open())


def condition_of(store: Store, scanner: StoredScanner) -> ScannerCondition:
    """Return the condition of one scanner; raise `NotFound` if it was deleted a moment ago."""
    found = _conditions(store, store.overviews.read(scanner_id=scanner.id), store.alarms.open(scanner_id=scanner.id))
    if not found:
        raise NotFound("scanner", scanner.id)
    return found[0]


def step_with(store: Store, calibration: CalibrationSucceeded) -> NextStep:
    """Return the next step with a calibration, by the state of its scanner now."""
    discard = store.history.newest(calibration.scanner_id, HistoryKind.DISCARD, calibration.id)
    condition = condition_of(store, store.scanners.get(calibration.scanner_id))
    return condition.step_with(calibration, discarded=discard is not None)


def _conditions(store: Store, overviews: Iterable[Overview], opened: Iterable[Alarm]) -> list[ScannerCondition]:
    overviews = list(overviews)
    shown = ((each.ended_id, each.succeeded_id, each.red_id, each.scanner.active_calibration_id) for each in overviews)
    calibrations = store.calibrations.several([one for one in {*chain.from_iterable(shown)} if one is not None])
    check_ids = {one for each in overviews for one in (each.drift_id, each.seen_id)}
    checks = store.drifts.several([one for one in check_ids if one is not None])
    now, noticed = store.now(), store.alarms.known_reds()
    alarms: defaultdict[str, list[Alarm]] = defaultdict(list)
    for alarm in opened:
        alarms[alarm.scanner_id].append(alarm)

    def succeeded(identifier: str | None) -> CalibrationSucceeded | None:
        calibration = None if identifier is None else calibrations.get(identifier)
        return calibration if isinstance(calibration, CalibrationSucceeded) else None

    def condition(of: Overview) -> ScannerCondition:
        last = None if of.ended_id is None else calibrations.get(of.ended_id)
        mine = alarms[of.scanner.id]
        return ScannerCondition(
            scanner=of.scanner,
            newest=succeeded(of.succeeded_id),
            red=succeeded(of.red_id),
            active=succeeded(of.scanner.active_calibration_id),
            failed=last if isinstance(last, CalibrationUnfinished) else None,
            drift=None if of.drift_id is None else checks.get(of.drift_id),
            seen=None if of.seen_id is None else checks.get(of.seen_id),
            scanned=of.scan_id is not None,
            calibrating=of.calibrating,
            alarms=tuple(mine),
            acknowledged=frozenset(alarm.kind for alarm in mine if is_acknowledged(alarm, now)),
            discarded_at=of.discarded_at,
            noticed=noticed.get(of.scanner.id),
        )

    return [condition(each) for each in overviews]
