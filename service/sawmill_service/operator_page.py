"""The operator's page: is each scanner in tolerance, what moved and how far, accept or roll back. Plain HTML."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sawmill_service.access import Caller
from sawmill_service.pages.frame import templates
from sawmill_worker.contracts.calibrations import CalibrationSucceeded
from sawmill_worker.contracts.drifts import Drift, DriftResult
from sawmill_worker.contracts.jobs import Failure
from sawmill_worker.contracts.keys import Scope
from sawmill_worker.contracts.scanners import Activation, StoredScanner


@dataclass(frozen=True)
class Standing:
    """Whether a scanner is in tolerance: in a word, a colour's name and a sentence."""

    word: str
    tone: str
    sentence: str


@dataclass(frozen=True)
class ScannerCondition:
    """What the page shows of one scanner.

    `newest` is the newest calibration that succeeded, `failure` why a newer one did not; `drift` is the newest drift
    check that succeeded or failed; `history` has the newest activation first.
    """

    scanner: StoredScanner
    newest: CalibrationSucceeded | None
    failure: Failure | None
    drift: Drift | None
    history: Sequence[Activation]

    @property
    def newest_is_active(self) -> bool:
        """Whether the newest calibration is what the scanner's reconstructions use."""
        return self.newest is not None and self.newest.id == self.scanner.active_calibration_id

    @property
    def drifted(self) -> DriftResult | None:
        """The newest drift check, if it is later than the newest calibration and the active one is out of tolerance."""
        check = self.drift
        if check is None or check.result is None or check.result.within_tolerance is not False:
            return None
        of_active = check.calibration_id == self.scanner.active_calibration_id
        later = self.newest is None or check.created_at >= self.newest.created_at
        return check.result if of_active and later else None

    @property
    def standing(self) -> Standing:
        """By the newest calibration (its verdict, then what moved since the active one) and a later log."""
        newest = self.newest
        if newest is None:
            return Standing("Not calibrated", "idle", "No calibration of this scanner has succeeded yet.")
        reasons = " ".join(newest.reasons)
        if newest.verdict == "fail":
            return Standing("Calibration failed its check", "bad", reasons)
        if moved := self._moved_out_of_tolerance():
            return Standing("Out of tolerance", "bad", moved)
        if newest.verdict == "watch":
            return Standing("Watch", "watch", reasons)
        if self.scanner.active_calibration_id is None:
            return Standing("No active calibration", "watch", "The newest calibration passed: accept it to use it.")
        unmoved = newest.comparison.reason if newest.comparison and not self.newest_is_active else ""
        return Standing("In tolerance", "good", unmoved or "The newest calibration passed and is the active one.")

    def _moved_out_of_tolerance(self) -> str:
        """What moved since the active calibration, by the newest one or a later log; empty where nothing did."""
        comparison = self.newest.comparison if self.newest else None
        if comparison is not None and not comparison.within_tolerance and not self.newest_is_active:
            return comparison.reason
        return f"A log shows: {self.drifted.reason}." if self.drifted else ""


def drift_standing(check: Drift) -> Standing:
    """What the log showed, or why it showed nothing."""
    result = check.result
    if result is None:
        return Standing("Could not be seen", "watch", check.failure.detail if check.failure else check.state)
    if result.within_tolerance is None:
        return Standing("Could not be seen", "watch", result.reason)
    column, tilt = result.change.cor_column_mm, math.degrees(result.change.tilt_rad)
    moved = (
        f"rays moved {result.ray_change_mm:.3f} mm RMS of {result.tolerance_mm:g} mm allowed, "
        f"COR {column:+.3f} mm, tilt {tilt:+.3f}°; {result.reason}"
    )
    if result.within_tolerance:
        return Standing("In tolerance", "good", moved)
    return Standing("Out of tolerance", "bad", moved)


def operator_page(conditions: Sequence[ScannerCondition], caller: Caller) -> str:
    """The whole page as HTML, with the buttons that its caller may press."""
    return (
        templates()
        .get_template("operator.html")
        .render(
            conditions=conditions,
            drift_standing=drift_standing,
            caller=caller,
            may_activate=caller.scope.covers(Scope.ACTIVATE),
        )
    )
