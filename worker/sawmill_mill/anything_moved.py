"""The third question next to a verdict: did anything move, since the calibration in use or during the scan."""

from dataclasses import dataclass
from typing import Self

from sawmill_contracts.calibrations import CalibrationResult, Comparison
from sawmill_mill.two_questions import Answer
from sawmill_vocabulary import MovedBody
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.messages import N_, Message, Reason
from sawmill_vocabulary.movement_messages import MovementMessage
from sawmill_vocabulary.scan_messages import EffectMessage

# Messages on a phantom or a scanner that moved while the phantom was scanned.
SLIPS: frozenset[str] = frozenset(
    {
        EffectMessage.SLIP,
        EffectMessage.PHANTOM_CREEP,
        EffectMessage.PHANTOM_SETTLES,
        EffectMessage.PHANTOM_UNSTEADY,
        EffectMessage.SCANNER_JUMP,
        EffectMessage.SCANNER_CREEP,
        EffectMessage.WARMS_UP,
        EffectMessage.SCANNER_UNSTEADY,
        CalibrationMessage.PHANTOM_SLIPPED,
        CalibrationMessage.PHANTOM_SLIPPED_OR_DRAWN,
        CalibrationMessage.PHANTOM_OR_LOG_MOVED,
        CalibrationMessage.BOTH_MOVED,
    }
)


class StandIn(Message):
    """Messages where no reason of the science is known."""

    NOT_COMPARED = "not-compared", N_("Not known: no calibration was in use to compare with.")
    # The reason of an earlier version is an English sentence alone.
    EARLIER_VERSION = "earlier-version", N_("Something speaks against it."), N_("Read the reason, which is in English.")
    CHANGED = "changed", N_("Something has changed since the calibration in use.")


@dataclass(frozen=True)
class AnythingMoved:
    """The third question about one calibration, with a number, its limit and the reason."""

    answer: Answer  # `no`: the scanner has moved; `look`: the phantom or the scanner moved during the scan
    reason: Reason  # how the scanner compares with the calibration that was in use
    slip: Reason | None = None  # what moved during the scan; None: nothing
    # moved_mm, limit_mm: RMS distance by which the rays moved since the calibration that was in use; None without one.
    moved_mm: float | None = None
    limit_mm: float | None = None

    question = N_("Did anything move?")

    @classmethod
    def of(cls, result: CalibrationResult, *, accepted: bool = False) -> Self:
        """Ask about an answer; one that is in use has taken the movement up."""
        comparison, slip = result.comparison, slip_of(result)
        slipped = Answer.ACCEPTED if accepted else Answer.LOOK
        if comparison is None:
            return cls(Answer.UNKNOWN if slip is None else slipped, StandIn.NOT_COMPARED(), slip)
        numbers = slip, comparison.ray_change_mm, comparison.tolerance_mm
        moved = moved_reason(comparison)
        if moved is not None:
            return cls(Answer.ACCEPTED if accepted else Answer.NO, comparison.explanation.reason or moved, *numbers)
        within = MovementMessage.WITHIN(moved_mm=comparison.ray_change_mm, allowed_mm=comparison.tolerance_mm or 0.0)
        return cls(Answer.YES if slip is None else slipped, within, *numbers)


def slip_of(result: CalibrationResult) -> Reason | None:
    """Return the reason that reports a movement during the scan; None where nothing moved by more than matters."""
    for explained in result.explanations:
        reason = explained.reason
        if reason is not None and not SLIPS.isdisjoint(reason.codes):
            return reason
    witness = result.log_check
    if witness is not None and witness.moved in {MovedBody.PHANTOM, MovedBody.BOTH} and not result.coded_reasons:
        return CalibrationMessage.PHANTOM_SLIPPED()
    return None


def moved_reason(comparison: Comparison, tolerance_mm: float = 0.0) -> Reason | None:
    """Return the reason for a movement beyond tolerance, without its cause; None within tolerance."""
    moved_mm, allowed_mm = comparison.ray_change_mm, comparison.tolerance_mm or tolerance_mm
    if comparison.within_tolerance:
        return None
    if moved_mm <= allowed_mm:
        return StandIn.CHANGED()
    return MovementMessage.MOVED(MovementMessage.UNKNOWN_CAUSE(), moved_mm=moved_mm, allowed_mm=allowed_mm)
