"""CalibrationStatus and verdict, with reasons that name a likely cause and what to do."""

import math
from dataclasses import dataclass

from sawmill_worker.tomography.calibration.calibration import HypothesisReport
from sawmill_worker.tomography.calibration.fit import Fit
from sawmill_worker.tomography.calibration.structure import Place, Structure
from sawmill_worker.tomography.calibration.unsteadiness import Change, Unsteadiness
from sawmill_worker.tomography.ray_error import PredictedRayError
from sawmill_worker.vocabulary import CalibrationStatus

# Log-likelihood advantage over the next hypothesis below which the choice is not decisive.
DECISIVE = 10.0
# What the residual holds beside noise, as a share of the sinogram: above the first it is told, above the second the
# model is not the scan's and the calibration is to be watched.
TOLD, STRUCTURED = 0.001, 0.005
# Error bars that the residual widened by more than this are wide because of the model, not of the noise.
WIDENED = 2.0
# What changed during the scan is told where it puts the rays off by more than this share of the tolerance: a model that
# takes a mean over each cell where the scan has a few rays is itself off by less, and that can look like a change.
UNSTEADY = 0.1
# A free source distance that falls short of source_to_cor_mm by more standard deviations is no noise.
SHORT = 4.0

CAUSES = {
    Place.VIEWS: "in few views, as when the log moves or an exposure fails: look at these views and repeat the scan",
    Place.CELLS: "in single cells, the same in every view, as from flat fields of few frames or cells of unequal "
    "gain: take more flat frames, or have rings removed",
    Place.EDGES: "at the phantom's edges, as from a drawing that is not its shape (a coarse picture, worn corners): "
    "measure the phantom and draw it anew",
    Place.INSIDE: "inside the phantom's shadow, as from wood that is not uniform (a knot, moisture), beam hardening, "
    "or rows that show something else: use a sound phantom, and check the rows",
}


@dataclass(frozen=True)
class TurnedRival:
    """The best fit of the same hypothesis with the phantom turned."""

    by_deg: float
    relative_residual: float


@dataclass(frozen=True)
class Judgement:
    """What is thought of a calibration, reasons worst first."""

    status: CalibrationStatus
    verdict: str
    reasons: tuple[str, ...]


def judge(
    *,
    predicted: PredictedRayError,
    tolerance_mm: float,
    fit: Fit,
    inflation: float,
    widening: float,
    structure: Structure | None,
    unsteady: Unsteadiness | None,
    unsteady_mm: float,
    hypotheses: tuple[HypothesisReport, ...],
    turned: TurnedRival | None,
    turn_held: bool,
    samples: int,
    source_shift_resolved: bool,
    theta_in_bounds: bool,
    unconstrained_mm: float | None,
    short_of_deviations: float,
    source_to_cor_mm: float,
    scale_ray_error_mm: float,
) -> Judgement:
    """Status, verdict and reasons; `structure` is None where the residual is noise, `unsteady` where nothing changed.

    A tolerance is held when it is held with 95 % (ISO 14253-1): by the predicted ray error's upper bound. Where only
    its RMS is within the tolerance the calibration is to be watched. `unsteady_mm` is what the change puts the rays off
    by.
    """
    found = _Findings()
    if not fit.converged:
        cure = "repeat it with more views or another seed" if turn_held else "use a phantom with corners"
        found.fail(f"the fit did not converge: {cure}", CalibrationStatus.NOT_CONVERGED)
    if unsteady_mm <= UNSTEADY * tolerance_mm:
        unsteady = None
    if unsteady is not None:
        of_it = f"this puts the rays off by {unsteady_mm:.2g} mm, which the error bars include"
        found.watch(f"{_change(unsteady)}; {of_it}")
    _judge_rivals(found, hypotheses, turned, samples / inflation, turn_held=turn_held)
    if unconstrained_mm is not None:
        _judge_short_distance(found, unconstrained_mm, source_to_cor_mm, short_of_deviations)
    if predicted.upper_95_mm > tolerance_mm:
        imprecise = _imprecise(predicted, tolerance_mm, of_the_model=widening > WIDENED or unsteady is not None)
        (found.watch if predicted.rms_mm <= tolerance_mm else found.fail)(imprecise, CalibrationStatus.IMPRECISE)
    if structure is not None and structure.share > TOLD and unsteady is None:
        told = (
            f"the phantom's model leaves {structure.share:.1%} of the sinogram unexplained, and not as noise, most of "
            f"it {CAUSES[structure.place]}"
        )
        (found.watch if structure.share > STRUCTURED else found.note)(told)
    if not theta_in_bounds:
        found.watch("theta lies outside the scanner's bounds: check the scanner's constants, or widen the bounds")
    if unconstrained_mm is None and not source_shift_resolved:
        found.note("the source shift is not resolved from 0, so theta has no standard deviations; the rays have")
    if scale_ray_error_mm > tolerance_mm:
        found.note(
            f"the phantom's stated size tolerance alone leaves the rays uncertain by {scale_ray_error_mm:.3f} mm "
            f"RMS, which no residual shows, where {tolerance_mm:.3f} mm is allowed: measure the phantom and state a "
            "smaller size_tolerance"
        )
    return found.judgement()


class _Findings:
    """What speaks against an answer, in three degrees, and what it is to be called: the first status is the worst."""

    def __init__(self) -> None:
        self._fails: list[str] = []
        self._watches: list[str] = []
        self._notes: list[str] = []
        self._statuses: list[CalibrationStatus] = []

    def fail(self, reason: str, status: CalibrationStatus) -> None:
        self._fails.append(reason)
        self._statuses.append(status)

    def watch(self, reason: str, status: CalibrationStatus | None = None) -> None:
        self._watches.append(reason)
        if status is not None:
            self._statuses.append(status)

    def note(self, reason: str) -> None:
        self._notes.append(reason)

    def judgement(self) -> Judgement:
        verdict = "fail" if self._fails else "watch" if self._watches else "pass"
        status = next(iter(self._statuses), CalibrationStatus.CALIBRATED)
        return Judgement(status, verdict, (*self._fails, *self._watches, *self._notes))


def _judge_rivals(
    found: _Findings,
    hypotheses: tuple[HypothesisReport, ...],
    turned: TurnedRival | None,
    independent_samples: float,
    *,
    turn_held: bool,
) -> None:
    """Whether another side, sense of rotation or first angle explains the scan as well."""
    best = hypotheses[0]

    def undecided(rival: float) -> bool:
        """Whether the best hypothesis's log-likelihood hardly beats another's, told by its relative residual."""
        return independent_samples * math.log(max(rival, 1e-12) / max(best.relative_residual, 1e-12)) < DECISIVE

    if len(hypotheses) > 1 and undecided(hypotheses[1].relative_residual):
        second = hypotheses[1]
        found.watch(
            f"the scan does not tell {best.handedness.value}, {best.rotation.value} from {second.handedness.value}, "
            f"{second.rotation.value}: say which it is, or use a phantom without symmetry",
            CalibrationStatus.AMBIGUOUS_HANDEDNESS,
        )
    if not turn_held:
        found.watch(
            "the phantom looks the same from every side, so nothing holds the first angle and its position: "
            "use a phantom without symmetry",
            CalibrationStatus.AMBIGUOUS_TURN,
        )
    elif turned is not None and undecided(turned.relative_residual):
        found.watch(
            f"the phantom looks the same turned by {turned.by_deg:.0f} degrees, so the first angle may be off by as "
            "much: use a phantom without symmetry",
            CalibrationStatus.AMBIGUOUS_TURN,
        )


def _judge_short_distance(
    found: _Findings, unconstrained_mm: float, source_to_cor_mm: float, short_of_deviations: float
) -> None:
    """Whether a free source distance below r_S is noise or a contradiction."""
    told = (
        f"the free fit put the source at {unconstrained_mm:.2f} mm, nearer than source_to_cor_mm {source_to_cor_mm:.2f}"
    )
    if short_of_deviations > SHORT:
        found.fail(
            f"{told} by {short_of_deviations:.0f} standard deviations: the phantom is larger than its drawing, by "
            f"{source_to_cor_mm / unconstrained_mm - 1.0:.1%} or more, or that constant is wrong: measure both",
            CalibrationStatus.INCONSISTENT_SCALE,
        )
    else:
        found.note(
            f"{told}, for which no theta exists: the source distance was held there, and the source shift is 0 within "
            "the noise"
        )


def _change(unsteady: Unsteadiness) -> str:
    """What changed, and what to do."""
    match unsteady.change:
        case Change.PHANTOM:
            return (
                f"the phantom moved at view {unsteady.view}, by {unsteady.by_mm:.2g} mm and {unsteady.by_deg:.2g} "
                "degrees: fasten it on the turntable and repeat the scan"
            )
        case Change.ANGLES:
            return (
                f"the angles jump at view {unsteady.view}, by {unsteady.by_deg:.2g} degrees: the drive or its encoder "
                "lost steps there, or the phantom turned in its place; look at them and repeat the scan"
            )
        case Change.PACE:
            return (
                f"the turntable turns {unsteady.pace:.4f} times as far as the angles say: check the angles' step and "
                "the encoder's counts in a turn"
            )
        case Change.SWING:
            return (
                f"the angles are ahead and behind once a turn, by {unsteady.by_deg:.2g} degrees: the encoder is off "
                "its axis, or the turntable's drive slips and catches; look at them"
            )


def _imprecise(predicted: PredictedRayError, tolerance_mm: float, *, of_the_model: bool) -> str:
    cure = (
        "the model is not the scan's, as is said beside this, and more views alone will not help"
        if of_the_model
        else "use more views, more rows or a longer exposure"
    )
    return (
        f"the predicted ray error is {predicted.rms_mm:.3f} mm, with 95 % below {predicted.upper_95_mm:.3f} mm, where "
        f"{tolerance_mm:.3f} mm is allowed: {cure}"
    )
