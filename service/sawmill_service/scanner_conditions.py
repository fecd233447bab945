"""How each scanner stands, as the store has it: for the pages, and for whoever watches from outside."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

from sawmill_contracts.alarms import Alarm, AlarmKind
from sawmill_contracts.calibrations import CalibrationSucceeded, CalibrationUnfinished, Comparison
from sawmill_contracts.drifts import Drift, DriftResult
from sawmill_contracts.jobs import Failure
from sawmill_contracts.scanners import StoredScanner
from sawmill_service.pages.frame.languages import marked
from sawmill_store.errors import NotFound
from sawmill_store.overviews import Overview
from sawmill_store.store import Store

SHOWN_SCANNERS = 200  # more than any mill has
# From here on a scanner is watched, though it is allowed to move by more: the next check may find it beyond.
NEARLY = 0.7
ALARMS = {
    AlarmKind.DRIFT: marked("Its logs together show that it has moved: scan the phantom and calibrate."),
    AlarmKind.PHANTOM_EXPIRED: marked("The measurement of its phantom has expired: measure the phantom again."),
    AlarmKind.SCANNER_QUIET: marked("It has sent no scan for longer than it may: look at the scanner and its network."),
    AlarmKind.NO_PHANTOM_SCAN: marked("No phantom was scanned for longer than is allowed: scan one and calibrate."),
}


@dataclass(frozen=True)
class Standing:
    """Whether a scanner is in tolerance: in a word, a colour's name and a sentence.

    `scientific` sentences come from a result and are English in every language; the others are in the catalogues.
    """

    word: str
    tone: str
    sentence: str
    scientific: bool = False


@dataclass(frozen=True)
class Moved:
    """How far a scanner's rays have moved against a calibration, by a later one or by a log.

    `since_active` tells that this calibration is still in use; otherwise a newer one has taken the movement up.
    """

    ray_change_mm: float
    tolerance_mm: float
    within_tolerance: bool
    at: datetime
    since_active: bool

    @property
    def share(self) -> float:
        """Of what is allowed."""
        return self.ray_change_mm / self.tolerance_mm

    @property
    def tone(self) -> str:
        """The colour of its bar: none where the movement has been taken up."""
        if not self.since_active:
            return "idle"
        return "bad" if not self.within_tolerance else "watch" if self.share >= NEARLY else "good"


@dataclass(frozen=True)
class ScannerCondition:
    """What the pages show of one scanner.

    `newest` is the newest calibration that succeeded, `failure` why a newer one did not; `active` is in use; `drift` is
    the newest drift check that succeeded or failed, `seen` the newest that could tell whether it has moved since
    `active`. `alarms` are those that are open.
    """

    scanner: StoredScanner
    newest: CalibrationSucceeded | None
    active: CalibrationSucceeded | None
    failure: Failure | None
    drift: Drift | None
    seen: Drift | None
    scanned: bool
    calibrating: bool
    alarms: tuple[Alarm, ...]

    @property
    def newest_is_active(self) -> bool:
        """Whether the newest calibration is what the scanner's reconstructions use."""
        return self.newest is not None and self.newest.id == self.scanner.active_calibration_id

    @property
    def drifted(self) -> DriftResult | None:
        """What the newest check saw, if it is later than the newest calibration and out of tolerance."""
        check = self._since_newest(self.seen)
        return check.result if check is not None and check.result and check.result.within_tolerance is False else None

    @property
    def unseen(self) -> Drift | None:
        """The newest drift check, if it failed or could not tell: what an earlier one saw holds still."""
        check = self._since_newest(self.drift)
        if check is None or check.calibration_id != self.scanner.active_calibration_id:
            return None
        return None if check.result is not None and check.result.within_tolerance is not None else check

    @property
    def moved(self) -> Moved | None:
        """What is known last of how far it has moved; None: nothing has looked."""
        check = self._since_newest(self.seen)
        if check is not None and check.result is not None:
            result = check.result
            within = result.within_tolerance is True
            return Moved(result.ray_change_mm, result.tolerance_mm, within, check.created_at, since_active=True)
        newest, since_active = self.newest, self.compared
        change = newest.comparison if newest is not None and self.newest_is_active else since_active
        if newest is None or change is None:
            return None
        return Moved(
            change.ray_change_mm,
            change.tolerance_mm or self.scanner.tolerances.ray_change_mm,
            change.within_tolerance,
            newest.created_at,
            since_active=since_active is not None,
        )

    @property
    def compared(self) -> Comparison | None:
        """What the newest calibration shows against the one in use; None too where it was held against another one."""
        found = None if self.newest is None or self.newest_is_active else self.newest.comparison
        return found if found is not None and found.calibration_id == self.scanner.active_calibration_id else None

    @property
    def is_compared(self) -> bool:
        """Whether anything has looked how far the scanner has moved since the calibration in use."""
        return self.compared is not None or self._since_newest(self.seen) is not None

    @property
    def standing(self) -> Standing:
        """By the newest calibration (its verdict, then what moved since the active one) and a later log."""
        newest = self.newest
        if newest is None:
            return self._without_calibration()
        right = marked("It stands where its calibration says.")
        if not self.is_compared:
            right = marked("It was right when it was calibrated.")
        not_fine = self._out_of_tolerance(newest) or self._to_be_watched(newest) or self._alarmed()
        return not_fine or Standing(marked("Fine"), "good", right)

    @property
    def needs_somebody(self) -> bool:
        """Whether a person must do something."""
        return self.standing.tone != "good"

    @property
    def wants_review(self) -> bool:
        """Whether the next step is to look at the newest calibration, and not to make another."""
        if self.newest is None or self.failure is not None or self.drifted is not None or self.newest.verdict == "fail":
            return False
        return self.active is None or self.compared is not None

    def _out_of_tolerance(self, newest: CalibrationSucceeded) -> Standing | None:
        if newest.verdict == "fail":
            return Standing(marked("Calibration failed"), "bad", _sentences(newest.reasons), scientific=True)
        if moved := self._moved_out_of_tolerance():
            return Standing(marked("Out of tolerance"), "bad", moved, scientific=True)
        return None

    def _to_be_watched(self, newest: CalibrationSucceeded) -> Standing | None:
        if self.failure is not None:
            return Standing(marked("Last calibration failed"), "watch", self.failure.detail, scientific=True)
        if newest.verdict == "watch":
            return Standing(marked("Watch"), "watch", _sentences(newest.reasons), scientific=True)
        if self.scanner.active_calibration_id is None:
            passed = marked("The newest calibration passed: accept it to use it.")
            return Standing(marked("Not accepted"), "watch", passed)
        if not self.newest_is_active and not self.is_compared:
            unknown = marked("Nothing has compared it with the calibration in use: calibrate it.")
            return Standing(marked("Watch"), "watch", unknown)
        if self.moved is not None and self.moved.since_active and self.moved.share >= NEARLY:
            little_left = marked("It has moved nearly as far as is allowed: calibrate it today.")
            if not self.newest_is_active:
                little_left = marked("It has moved nearly as far as is allowed: accept its newest calibration.")
            return Standing(marked("Watch"), "watch", little_left)
        return None

    def _alarmed(self) -> Standing | None:
        return Standing(marked("Watch"), "watch", ALARMS[self.alarms[0].what]) if self.alarms else None

    def _without_calibration(self) -> Standing:
        if self.failure is not None:
            return Standing(marked("Calibration failed"), "bad", self.failure.detail, scientific=True)
        if self.scanned:
            return Standing(marked("Never calibrated"), "idle", marked("It has been scanned, and not calibrated yet."))
        return Standing(marked("New"), "idle", marked("It has no scan yet: mount the phantom and calibrate."))

    def _moved_out_of_tolerance(self) -> str:
        """What moved since the active calibration, by the newest one or a later log; empty where nothing did."""
        if self.compared is not None and not self.compared.within_tolerance:
            return self.compared.reason
        return f"A log shows: {self.drifted.reason}." if self.drifted else ""

    def _since_newest(self, check: Drift | None) -> Drift | None:
        """A drift check, if the newest calibration is no later."""
        if check is None or (self.newest is not None and check.created_at < self.newest.created_at):
            return None
        return check


def _sentences(reasons: Iterable[str]) -> str:
    """One after the other; a symbol at the beginning, as h_S, stays as it is."""
    ended = (f"{reason.rstrip('.')}." for reason in reasons)
    return " ".join(each[:1].upper() + each[1:] if each[1:2].isalpha() else each for each in ended)


def conditions_of(store: Store) -> list[ScannerCondition]:
    """Of all scanners, the newest first; a few questions to the store, however many there are."""
    return _conditions(store, store.overviews.read(limit=SHOWN_SCANNERS), store.alarms.open())


def condition_of(store: Store, scanner: StoredScanner) -> ScannerCondition:
    """How one of them stands, or `NotFound`: it was deleted a moment ago."""
    opened = store.alarms.open(scanner_id=scanner.id)
    found = _conditions(store, store.overviews.read(scanner_id=scanner.id), opened)
    if not found:
        raise NotFound("scanner", scanner.id)
    return found[0]


def _conditions(store: Store, overviews: Iterable[Overview], opened: Iterable[Alarm]) -> list[ScannerCondition]:
    overviews = list(overviews)
    ids = {one for each in overviews for one in (each.ended_id, each.succeeded_id, each.scanner.active_calibration_id)}
    calibrations = store.calibrations.several([one for one in ids if one is not None])
    check_ids = {one for each in overviews for one in (each.drift_id, each.seen_id)}
    checks = store.drifts.several([one for one in check_ids if one is not None])
    alarms: defaultdict[str, list[Alarm]] = defaultdict(list)
    for alarm in opened:
        alarms[alarm.scanner_id].append(alarm)

    def succeeded(identifier: str | None) -> CalibrationSucceeded | None:
        calibration = None if identifier is None else calibrations.get(identifier)
        return calibration if isinstance(calibration, CalibrationSucceeded) else None

    def condition(of: Overview) -> ScannerCondition:
        last = None if of.ended_id is None else calibrations.get(of.ended_id)
        return ScannerCondition(
            scanner=of.scanner,
            newest=succeeded(of.succeeded_id),
            active=succeeded(of.scanner.active_calibration_id),
            failure=last.failure if isinstance(last, CalibrationUnfinished) else None,
            drift=None if of.drift_id is None else checks.get(of.drift_id),
            seen=None if of.seen_id is None else checks.get(of.seen_id),
            scanned=of.scan_id is not None,
            calibrating=of.calibrating,
            alarms=tuple(alarms[of.scanner.id]),
        )

    return [condition(each) for each in overviews]
