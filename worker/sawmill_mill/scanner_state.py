"""The standing of a scanner: fine, to be watched or out of tolerance, and what a person does next."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import Comparison
from sawmill_mill.alarms import ALARMS
from sawmill_vocabulary import Verdict
from sawmill_vocabulary.texts import N_

# From this share on a scanner is watched, though it may move by more: the next check may find it out of tolerance.
NEARLY = 0.7


@dataclass(frozen=True)
class Standing:
    """The answer whether a scanner is in tolerance: a word, a colour's name and a sentence.

    `scientific` sentences come from a result and are English in every language; the catalogues have all other ones.
    """

    word: str
    tone: str
    sentence: str
    scientific: bool = False


@dataclass(frozen=True)
class Moved:
    """The movement of a scanner's rays since a calibration, seen by a later calibration or by a log.

    `since_active` tells that this calibration is still in use; otherwise a newer one has taken the movement up.
    """

    ray_change_mm: float
    tolerance_mm: float
    within_tolerance: bool
    at: datetime
    since_active: bool

    @property
    def share(self) -> float:
        """Share of the tolerance."""
        return self.ray_change_mm / self.tolerance_mm

    @property
    def tone(self) -> str:
        """Colour of the bar: `idle` where a calibration has taken the movement up."""
        if not self.since_active:
            return "idle"
        return "bad" if not self.within_tolerance else "watch" if self.share >= NEARLY else "good"


class Calibrated(NamedTuple):
    """A calibration that succeeded."""

    id: str
    created_at: datetime
    verdict: Verdict
    reasons: Sequence[str] = ()
    comparison: Comparison | None = None


class Checked(NamedTuple):
    """A drift check that ended; `within_tolerance` is None where it failed or could not tell."""

    created_at: datetime
    calibration_id: str
    within_tolerance: bool | None
    ray_change_mm: float = 0.0
    tolerance_mm: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class ScannerState:
    """The facts about one scanner that decide its standing.

    `newest` is the newest calibration that succeeded, `active_id` the one in use, `failure` why a newer one failed.
    `last_check` is the newest drift check that ended, `seen` the newest one that could tell whether the scanner has
    moved since the active calibration. `ray_change_mm` is the tolerance of movement. `alarms` are the open ones.
    """

    newest: Calibrated | None = None
    active_id: str | None = None
    ray_change_mm: float = 0.5
    failure: str | None = None
    last_check: Checked | None = None
    seen: Checked | None = None
    scanned: bool = True
    alarms: tuple[AlarmKind, ...] = ()

    @property
    def newest_is_active(self) -> bool:
        """True if the scanner's reconstructions use the newest calibration."""
        return self.newest is not None and self.newest.id == self.active_id

    @property
    def drifted(self) -> Checked | None:
        """The newest check that could tell, if it is later than the newest calibration and out of tolerance."""
        check = self._since_newest(self.seen)
        return check if check is not None and check.within_tolerance is False else None

    @property
    def unseen(self) -> bool:
        """True if the newest drift check failed or could not tell: what an earlier check saw is still valid."""
        check = self._since_newest(self.last_check)
        return check is not None and check.calibration_id == self.active_id and check.within_tolerance is None

    @property
    def moved(self) -> Moved | None:
        """The last known movement; None where nothing has compared."""
        check = self._since_newest(self.seen)
        if check is not None:
            within = check.within_tolerance is True
            return Moved(check.ray_change_mm, check.tolerance_mm, within, check.created_at, since_active=True)
        newest, since_active = self.newest, self.compared
        change = newest.comparison if newest is not None and self.newest_is_active else since_active
        if newest is None or change is None:
            return None
        return Moved(
            change.ray_change_mm,
            change.tolerance_mm or self.ray_change_mm,
            change.within_tolerance,
            newest.created_at,
            since_active=since_active is not None,
        )

    @property
    def compared(self) -> Comparison | None:
        """The newest calibration against the one in use; None where it was compared with another one."""
        comparison = None if self.newest is None or self.newest_is_active else self.newest.comparison
        return comparison if comparison is not None and comparison.calibration_id == self.active_id else None

    @property
    def is_compared(self) -> bool:
        """True if a calibration or a log shows how far the scanner has moved since the calibration in use."""
        return self.compared is not None or self._since_newest(self.seen) is not None

    @property
    def standing(self) -> Standing:
        """Standing by the newest calibration (its verdict, then the movement since the active one) and a later log."""
        newest = self.newest
        if newest is None:
            return self._without_calibration()
        right = N_("It stands where its calibration says.")
        if not self.is_compared:
            right = N_("It was right when it was calibrated.")
        not_fine = self._out_of_tolerance(newest) or self._to_be_watched(newest) or self._alarmed()
        return not_fine or Standing(N_("Fine"), "good", right)

    @property
    def needs_somebody(self) -> bool:
        """True if a person must do something."""
        return self.standing.tone != "good"

    @property
    def wants_review(self) -> bool:
        """True if the next step is to review the newest calibration, and not to make another."""
        if self.newest is None or self.failure is not None or self.drifted is not None or self.newest.verdict == "fail":
            return False
        return self.active_id is None or self.compared is not None

    def _out_of_tolerance(self, newest: Calibrated) -> Standing | None:
        if newest.verdict == "fail":
            return Standing(N_("Calibration failed"), "bad", _sentences(newest.reasons), scientific=True)
        if moved := self._moved_out_of_tolerance():
            return Standing(N_("Out of tolerance"), "bad", moved, scientific=True)
        return None

    def _to_be_watched(self, newest: Calibrated) -> Standing | None:
        if self.failure is not None:
            return Standing(N_("Last calibration failed"), "watch", self.failure, scientific=True)
        if newest.verdict == "watch":
            return Standing(N_("Watch"), "watch", _sentences(newest.reasons), scientific=True)
        if self.active_id is None:
            passed = N_("The newest calibration passed: accept it to use it.")
            return Standing(N_("Not accepted"), "watch", passed)
        if not self.newest_is_active and not self.is_compared:
            unknown = N_("Nothing has compared it with the calibration in use: calibrate it.")
            return Standing(N_("Watch"), "watch", unknown)
        if self.moved is not None and self.moved.since_active and self.moved.share >= NEARLY:
            little_left = N_("It has moved nearly as far as is allowed: calibrate it today.")
            if not self.newest_is_active:
                little_left = N_("It has moved nearly as far as is allowed: accept its newest calibration.")
            return Standing(N_("Watch"), "watch", little_left)
        return None

    def _alarmed(self) -> Standing | None:
        return Standing(N_("Watch"), "watch", ALARMS[self.alarms[0]].advice) if self.alarms else None

    def _without_calibration(self) -> Standing:
        if self.failure is not None:
            return Standing(N_("Calibration failed"), "bad", self.failure, scientific=True)
        if self.scanned:
            return Standing(N_("Never calibrated"), "idle", N_("It has been scanned, and not calibrated yet."))
        return Standing(N_("New"), "idle", N_("It has no scan yet: mount the phantom and calibrate."))

    def _moved_out_of_tolerance(self) -> str:
        """Return what moved since the active calibration, by the newest one or a later log; empty if nothing did."""
        if self.compared is not None and not self.compared.within_tolerance:
            return self.compared.reason
        return f"A log shows: {self.drifted.reason}." if self.drifted else ""

    def _since_newest(self, check: Checked | None) -> Checked | None:
        """Return a drift check if the newest calibration is no later."""
        if check is None or (self.newest is not None and check.created_at < self.newest.created_at):
            return None
        return check


def _sentences(reasons: Iterable[str]) -> str:
    """Join reasons to sentences; a symbol at the beginning, as h_S, stays as it is."""
    ended = (f"{reason.rstrip('.')}." for reason in reasons)
    return " ".join(each[:1].upper() + each[1:] if each[1:2].isalpha() else each for each in ended)
