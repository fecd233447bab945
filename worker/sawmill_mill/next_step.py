"""The next step of a person with a scanner: one headline, what to do, and one button.

Pages, reports, answers for programs and events take the step from `next_step`, so that they never contradict one
another. docs/do/technician.md tells the technician the same.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Self

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_contracts.next_steps import NextStepAnswer
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import Tolerances
from sawmill_mill.alarms import ALARMS
from sawmill_mill.anything_moved import StandIn, moved_reason, slip_of
from sawmill_mill.scanner_state import NEARLY, Calibrated, Checked, ScannerState
from sawmill_mill.two_questions import Answer, TwoQuestions
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.messages import N_, Message, Reason
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage

# The 95 % number over the size's standard uncertainty, where the size is one of two equal shares in quadrature.
HALF_OF_IT_SIZE = 1.96 * 2.0**0.5


class Button(StrEnum):
    """The one button of a step, with its word."""

    NONE = "none", ""
    ACCEPT = "accept", N_("Accept")
    CALIBRATE = "calibrate", N_("Calibrate")
    SCAN_AGAIN = "scan-again", N_("Scan again")
    MEASURE = "measure", N_("Measure the phantom")
    LOOK = "look", N_("Look at the report")
    NEWEST = "newest", N_("Look at the newest calibration")
    CHOSEN = "chosen", N_("Look at the calibration that was chosen")

    word: str

    def __new__(cls, code: str, word: str) -> Self:
        """Make a code that carries its word."""
        button = str.__new__(cls, code)
        button._value_, button.word = code, word
        return button


_CALIBRATE = N_("Mount the phantom, scan it, and calibrate.")
_NOTHING = N_("Nothing needs to be done.")
_NEARLY = N_("It has moved nearly as far as is allowed: %(moved_mm).2f mm, and %(allowed_mm).2f mm is allowed.")


class StepMessage(Message):
    """Messages of the steps; an empty template takes the words of the reason for the step."""

    NEW = "new", N_("It has no scan yet."), _CALIBRATE
    NEVER = "never-calibrated", N_("It has never been calibrated."), _CALIBRATE
    IMPORTED = "imported", N_("Its geometry is imported, not checked."), _CALIBRATE
    FAILED = (
        "failed",
        N_("The scan of the phantom could not be calibrated."),
        N_("Scan the phantom again, and calibrate."),
    )
    FAILED_SINCE = (
        "failed-since",
        N_("The last scan of the phantom could not be calibrated. The calibration before it stays."),
        N_("Calibrate again today."),
    )
    WRONG = "wrong", N_("Do not use this calibration. %(headline)s")
    WRONG_IN_USE = (
        "wrong-in-use",
        N_("This calibration is in use and must not be. %(headline)s"),
        N_("Go back to an earlier one. %(action)s"),
    )
    LOG_SHOWS_MOVED = ("moved-since",)
    LOG_SHOWS_OFF = ("beyond-calibration",)
    SLIPPED = ("slipped",)
    MOVED = (
        "moved",
        "",
        N_(
            "%(action)s Then scan the phantom again. If the scanner was changed on purpose, accept the newest "
            "calibration."
        ),
    )
    STILL_RED = (
        "still-red",
        N_("%(headline)s The newest calibration does not show it."),
        N_("Check the scanner, and accept the newest calibration. If an earlier scan was disturbed, discard it."),
    )
    LOOK = ("look",)
    WITHOUT_ERROR_BARS = (
        "without-error-bars",
        N_("This calibration has no error bars."),
        N_("Look at the pictures before you use it."),
    )
    SCALE = "sizes-uncertain", "", N_("Accept it for sharp images. For right sizes: %(action)s")
    SCALE_IN_USE = "sizes-uncertain-in-use", "", N_("It is good for sharp images. For right sizes: %(action)s")
    NOT_ACCEPTED = (
        "not-accepted",
        N_("The calibration is good."),
        N_("Check that the orange line lies on the edge of the wood, and accept it."),
    )
    NOT_COMPARED = (
        "not-compared",
        N_("Nothing has compared the scanner with the calibration in use."),
        N_("Calibrate it."),
    )
    NEARLY = "moved-nearly", _NEARLY, N_("Calibrate today.")
    NEARLY_ACCEPT = "moved-nearly-and-calibrated", _NEARLY, N_("Accept its newest calibration.")
    ALARM = ("alarm",)
    FINE = "fine", N_("The scanner stands where its calibration says."), _NOTHING
    FINE_SINCE_CALIBRATED = "fine-since-calibrated", N_("The scanner was right when it was calibrated."), _NOTHING
    FINE_AND_NEWER = (
        "fine-and-newer",
        N_("The scanner stands where its calibration says, and a newer calibration is good."),
        N_("You may accept the newer one."),
    )
    OLDER = ("older", N_("A newer calibration of this scanner exists."), N_("Look at the newest one."))
    DISCARDED = ("discarded", N_("This calibration was discarded."), N_("Look at the newest one, or calibrate."))
    DECIDED_AGAINST = (
        "decided-against",
        N_("After this calibration was made, somebody chose another one."),
        N_("Look at the one that was chosen."),
    )
    OLDER_IN_USE = (
        "older-in-use",
        N_("This calibration is in use, and a newer one exists."),
        N_("Look at the newest one."),
    )


@dataclass(frozen=True)
class NextStep:
    """The next step."""

    reason: Reason  # headline, action and details in every language
    button: Button  # the one prominent button
    # tone, word: colour and word of the scanner: good, watch, bad or idle.
    tone: str
    word: str
    english: str | None = None  # sentence that an earlier version stored in place of a reason

    @property
    def answer(self) -> NextStepAnswer:
        """The step for programs."""
        return NextStepAnswer(
            tone=self.tone,
            word=self.word,
            button=self.button.value,
            reason=CodedReason.of(self.reason),
            english=self.english,
            **self.reason.in_words()._asdict(),
        )

    @property
    def needs_somebody(self) -> bool:
        """True if a person must do something."""
        return self.tone != "good"

    @property
    def card_tone(self) -> str:
        """Colour of a calibration with this step: one that is good and waits for somebody is green."""
        return "good" if self.reason.message is StepMessage.NOT_ACCEPTED else self.tone


# Button, colour and word of each step.
_STEPS = {
    StepMessage.NEW: (Button.CALIBRATE, "idle", N_("New")),
    StepMessage.NEVER: (Button.CALIBRATE, "idle", N_("Never calibrated")),
    StepMessage.IMPORTED: (Button.CALIBRATE, "idle", N_("Imported, not checked")),
    StepMessage.FAILED: (Button.CALIBRATE, "bad", N_("Calibration failed")),
    StepMessage.FAILED_SINCE: (Button.CALIBRATE, "watch", N_("Last calibration failed")),
    StepMessage.WRONG: (Button.SCAN_AGAIN, "bad", N_("Calibration failed")),
    StepMessage.WRONG_IN_USE: (Button.SCAN_AGAIN, "bad", N_("Calibration failed")),
    StepMessage.LOG_SHOWS_MOVED: (Button.CALIBRATE, "bad", N_("Out of tolerance")),
    StepMessage.LOG_SHOWS_OFF: (Button.CALIBRATE, "watch", N_("Watch")),
    StepMessage.SLIPPED: (Button.SCAN_AGAIN, "watch", N_("Watch")),
    StepMessage.MOVED: (Button.SCAN_AGAIN, "bad", N_("Out of tolerance")),
    StepMessage.STILL_RED: (Button.ACCEPT, "bad", N_("Out of tolerance")),
    StepMessage.LOOK: (Button.SCAN_AGAIN, "watch", N_("Watch")),
    StepMessage.WITHOUT_ERROR_BARS: (Button.LOOK, "watch", N_("Watch")),
    StepMessage.SCALE: (Button.ACCEPT, "watch", N_("Watch")),
    StepMessage.SCALE_IN_USE: (Button.MEASURE, "watch", N_("Watch")),
    StepMessage.NOT_ACCEPTED: (Button.ACCEPT, "watch", N_("Not accepted")),
    StepMessage.NOT_COMPARED: (Button.CALIBRATE, "watch", N_("Watch")),
    StepMessage.NEARLY: (Button.CALIBRATE, "watch", N_("Watch")),
    StepMessage.NEARLY_ACCEPT: (Button.ACCEPT, "watch", N_("Watch")),
    StepMessage.ALARM: (Button.CALIBRATE, "watch", N_("Watch")),
    StepMessage.FINE: (Button.NONE, "good", N_("Fine")),
    StepMessage.FINE_SINCE_CALIBRATED: (Button.NONE, "good", N_("Fine")),
    StepMessage.FINE_AND_NEWER: (Button.ACCEPT, "good", N_("Fine")),
    StepMessage.OLDER: (Button.NEWEST, "idle", N_("Not the newest")),
    StepMessage.DISCARDED: (Button.NEWEST, "idle", N_("Discarded")),
    StepMessage.DECIDED_AGAINST: (Button.CHOSEN, "idle", N_("Not chosen")),
    StepMessage.OLDER_IN_USE: (Button.NEWEST, "watch", N_("Not the newest")),
}

_ALARM_BUTTONS = {
    AlarmKind.NO_PHANTOM_SCAN: Button.CALIBRATE,
    AlarmKind.PHANTOM_EXPIRED: Button.MEASURE,
    AlarmKind.SCANNER_QUIET: Button.NONE,
    AlarmKind.DRIFT: Button.CALIBRATE,
}


def next_step(state: ScannerState) -> NextStep:
    """Return the next step with a scanner, which is also the next step with its newest calibration."""
    newest = state.newest
    if newest is None:
        uncalibrated = StepMessage.NEVER if state.scanned else StepMessage.NEW
        never = StepMessage.IMPORTED if state.imported else uncalibrated
        return _step(never if state.failure is None else StepMessage.FAILED)
    red = _out_of_tolerance(state, newest)
    failed = None if state.failure is None else _step(StepMessage.FAILED_SINCE)
    step = red or failed or _of_quality(state, newest) or _of_scanner(state) or _alarmed(state)
    return _still_red(state, step or _fine(state))


def step_alone(result: CalibrationResult, tolerances: Tolerances | None = None, *, active: bool = False) -> NextStep:
    """Return the next step with an answer alone, of whose scanner no more is known than whether it uses the answer."""
    before = None if result.comparison is None else result.comparison.calibration_id
    newest = Calibrated("", datetime.min.replace(tzinfo=UTC), result)
    return next_step(ScannerState(newest, newest.id if active else before, tolerances))


def step_of_check(check: DriftResult) -> NextStep | None:
    """Return the next step with a scanner that a log shows out of tolerance; None where the log shows no such thing."""
    return _log_shows_moved(check) if check.within_tolerance is False else None


def other_step(shown_at: datetime, newest_at: datetime, *, active: bool, discarded: bool = False) -> NextStep:
    """Return the next step with a calibration that is not the one by which its scanner is judged, by their times."""
    if discarded and not active:
        return _step(StepMessage.DISCARDED)
    if shown_at > newest_at:
        return _step(StepMessage.DECIDED_AGAINST)
    return _step(StepMessage.OLDER_IN_USE if active else StepMessage.OLDER)


def _out_of_tolerance(state: ScannerState, newest: Calibrated) -> NextStep | None:
    """Return the step where the calibration is wrong, or something moved: before it, during its scan, or since."""
    active, result = state.newest_is_active, newest.result
    if result.verdict_on_rays == "fail":
        return _because(StepMessage.WRONG_IN_USE if active else StepMessage.WRONG, _first(result))
    if state.drifted is not None:
        return _log_shows_moved(state.drifted)
    moved_since = None if state.compared is None else moved_reason(state.compared, state.allowed_mm)
    slip = None if active else slip_of(result)
    if slip is not None:
        step = _step(StepMessage.SLIPPED, slip)
        red = _STEPS[StepMessage.MOVED]
        return step if moved_since is None else replace(step, tone=red[1], word=red[2])
    if moved_since is not None and state.compared is not None:
        return _because(StepMessage.MOVED, state.compared.explanation, moved_since)
    return None


def _still_red(state: ScannerState, step: NextStep) -> NextStep:
    """Return the step in red where an earlier result is red that nobody has decided about since."""
    if step.tone == "bad" or state.newest_is_active:
        return step
    red = None if state.red is None else _out_of_tolerance(replace(state, newest=state.red, seen=None), state.red)
    if red is None and state.seen is not None and state.seen.within_tolerance is False:
        red = _log_shows_moved(state.seen)
    if red is None:
        return step
    if step.button is Button.ACCEPT or step.tone == "good":
        return NextStep(StepMessage.STILL_RED(*red.reason.parts), Button.ACCEPT, red.tone, red.word, red.english)
    return replace(step, tone=red.tone, word=red.word)


def _log_shows_moved(check: Checked | DriftResult) -> NextStep:
    unknown = MovementMessage.UNKNOWN_CAUSE()
    moved = LogMessage.MOVED(unknown, moved_mm=check.ray_change_mm, allowed_mm=check.tolerance_mm)
    return _because(StepMessage.LOG_SHOWS_MOVED, check.explanation, moved)


def _of_quality(state: ScannerState, newest: Calibrated) -> NextStep | None:
    """Return the step where the newest calibration is less than good."""
    both = TwoQuestions.of(newest.result, state.tolerances)
    if both.rays.answer is Answer.UNKNOWN:
        return _step(StepMessage.WITHOUT_ERROR_BARS)
    if both.rays.answer is Answer.LOOK:
        return _because(StepMessage.LOOK, _first(newest.result))
    if both.millimetres.answer is Answer.LOOK:
        return _of_scale(newest.result, both, active=state.newest_is_active)
    return _because(StepMessage.LOOK, _first(newest.result)) if newest.result.verdict == "watch" else None


def _of_scanner(state: ScannerState) -> NextStep | None:
    """Return the step where the newest calibration is good, and the scanner is not known to be."""
    active, moved = state.newest_is_active, state.moved
    if state.active_id is None:
        return _step(StepMessage.NOT_ACCEPTED)
    if not active and not state.is_compared:
        return _step(StepMessage.NOT_COMPARED)
    loses_contrast = state.shows(LogMessage.CALIBRATE_SOON)
    if loses_contrast is None and moved is not None and moved.since_active and moved.share >= NEARLY:
        message = StepMessage.NEARLY if active else StepMessage.NEARLY_ACCEPT
        return NextStep(message(moved_mm=moved.ray_change_mm, allowed_mm=moved.tolerance_mm), *_STEPS[message])
    off = loses_contrast or state.shows(LogMessage.BEYOND_CALIBRATION)
    if off is not None:
        step = _because(StepMessage.LOG_SHOWS_OFF, off.explanation)
        return step if active else replace(step, button=Button.ACCEPT)
    return None


def _alarmed(state: ScannerState) -> NextStep | None:
    if not state.alarms:
        return None
    what = state.alarms[0]
    step = _step(StepMessage.ALARM, ALARMS[what].message())
    waits = what is AlarmKind.DRIFT and state.compared is not None
    return replace(step, button=Button.ACCEPT if waits else _ALARM_BUTTONS[what])


def _fine(state: ScannerState) -> NextStep:
    if not state.newest_is_active and state.compared is not None:
        return _step(StepMessage.FINE_AND_NEWER)
    return _step(StepMessage.FINE if state.is_compared else StepMessage.FINE_SINCE_CALIBRATED)


def _of_scale(result: CalibrationResult, both: TwoQuestions, *, active: bool) -> NextStep:
    """Return the step where the rays are right and sizes are uncertain."""
    size = result.scale_uncertainty_mm / result.source_frame.source_distance_mm
    percent, allowed = both.millimetres.percent_95 or 0.0, both.millimetres.limit_percent or 0.0
    is_size = percent <= 100.0 * HALF_OF_IT_SIZE * size
    measure = CalibrationMessage.SCALE_SIZE(percent=percent, allowed_percent=allowed) if is_size else None
    explained = (each for each in result.explanations if (each.code or "").startswith("scale-"))
    first = next(explained, CodedReason.of(measure) if measure is not None else _first(result))
    step = _because(StepMessage.SCALE_IN_USE if active else StepMessage.SCALE, first)
    return replace(step, button=Button.SCAN_AGAIN) if active and not is_size else step


def _first(result: CalibrationResult) -> CodedReason | None:
    """Return the gravest reason that is not the movement of the scanner."""
    return next(iter(result.other_explanations), None)


def _because(message: StepMessage, explained: CodedReason | None, otherwise: Reason | None = None) -> NextStep:
    """Return the step for a reason; without words in every language, the step has `otherwise` and the English."""
    reason = None if explained is None else explained.reason
    if reason is not None:
        return _step(message, reason)
    return _step(
        message, otherwise or StandIn.EARLIER_VERSION(), english=None if explained is None else explained.sentence
    )


def _step(message: StepMessage, *parts: Reason, english: str | None = None) -> NextStep:
    return NextStep(message(*parts), *_STEPS[message], english)
