"""The next step of a person with a calibration, in one sentence, and the reason for that step."""

from dataclasses import dataclass
from enum import StrEnum

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_mill.two_questions import Answer, TwoQuestions

# The 95 % number over the size's standard uncertainty, where the size is one of two equal shares in quadrature.
HALF_OF_IT_SIZE = 1.96 * 2.0**0.5


class Action(StrEnum):
    """The next step in a word."""

    NOTHING = "nothing"
    ACCEPT = "accept"
    LOOK = "look"
    MEASURE = "measure"
    SCAN_AGAIN = "scan-again"


@dataclass(frozen=True)
class NextStep:
    """The next step.

    Attributes
    ----------
    message : str
        Sentence that ends in a colon where a reason follows.
    reason : str or None
        Sentence from the answer's reasons.
    """

    action: Action
    message: str
    reason: str | None = None


def next_step(result: CalibrationResult, both: TwoQuestions, *, active: bool) -> NextStep:
    """Return what to do with an answer; `active` where its scanner uses it already."""
    comparison, rays = result.comparison, both.rays.answer
    moved = None if comparison is None or comparison.within_tolerance else comparison.reason
    reason = next((each for each in result.reasons if each != moved), None)
    if rays is Answer.NO:
        return NextStep(Action.SCAN_AGAIN, _not_to_be_used(active=active), reason)
    if rays is Answer.LOOK:
        return NextStep(Action.SCAN_AGAIN, "Put this right, then scan the phantom again:", reason)
    if rays is Answer.UNKNOWN:
        return NextStep(Action.LOOK, "Look at the pictures before you use it: it has no error bars.")
    if active:
        return _scale_step(result, both, "It is in use. Nothing needs to be done.", reason)
    if moved is not None:
        text = "Find out what moved on the scanner. If the change is known, accept this calibration:"
        return NextStep(Action.LOOK, text, moved)
    return _scale_step(result, both, None, reason)


def _not_to_be_used(*, active: bool) -> str:
    if active:
        return "It is in use and must not be: go back to an earlier one, or put this right and scan again:"
    return "Do not use it. Put this right, then scan the phantom again:"


def _scale_step(result: CalibrationResult, both: TwoQuestions, in_use: str | None, reason: str | None) -> NextStep:
    """Return the next step where the rays are right, by the answer to the second question."""
    if both.millimetres.answer is not Answer.LOOK:
        accept = "Accept it."
        return NextStep(Action.NOTHING, in_use) if in_use else NextStep(Action.ACCEPT, accept)
    if _is_size(result):
        text = "Use it for sharp images. For right millimetres measure the phantom, and scan it again."
        return NextStep(Action.MEASURE, text)
    return NextStep(Action.MEASURE, "Use it for sharp images. For right millimetres put this right:", reason)


def _is_size(result: CalibrationResult) -> bool:
    """Return whether most of the scale's uncertainty is the phantom's size tolerance."""
    size = result.scale_uncertainty_mm / result.source_frame.source_distance_mm
    return (result.scale_uncertainty_percent or 0.0) <= 100.0 * HALF_OF_IT_SIZE * size
