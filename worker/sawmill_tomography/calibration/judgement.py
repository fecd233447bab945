"""Status, verdict and reasons: each kind of evidence is one function that yields remarks; the worst remarks decide."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

from sawmill_tomography.calibration.alternatives import Alternatives
from sawmill_tomography.calibration.error_bars import ErrorBars
from sawmill_tomography.calibration.faults.structure import ResidualPlace, Structure
from sawmill_tomography.calibration.fit import Fit, FittedModel
from sawmill_tomography.calibration.joint_fit.residual_analysis import ResidualAnalysis
from sawmill_tomography.calibration.scale import ScaleSource, ScaleUncertainty, size_by_distance
from sawmill_tomography.calibration.second_witness import LogWitness
from sawmill_tomography.calibration.source_distance import SourceDistance
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_vocabulary import Agreement, CalibrationStatus, MovedBody, Verdict

# Log-likelihood advantage over the next hypothesis below which the choice is not decisive.
DECISIVE = 10.0
# Structure in the residual is reported above this share of the sinogram. Structure alone never prevents a pass: its
# effect on the rays is in the error bars, and the error bars decide.
REPORTED = 0.001
# Error bars that exceed those for white noise by more than this factor are large because of the model.
MODEL_DOMINATED = 2.0
# An effect is a reason where the rays would be off by more than this share of the tolerance without it.
MATTERS = 0.1
# A free source distance that is less than source_to_cor_mm by more standard deviations is not explained by noise.
CONTRADICTION = 4.0

# Possible causes of a residual by its place, each with a remedy: the place alone does not show which cause is real.
CAUSES = {
    ResidualPlace.VIEWS: "in few views, as when the log moves or an exposure fails: look at these views and "
    "repeat the scan",
    ResidualPlace.CELLS: "in single cells, the same in every view, as from flat fields of few frames or cells of "
    "unequal gain: take more flat frames, or have rings removed",
    ResidualPlace.EDGES: "at the phantom's edges, which has several causes: a detector that lags or a turntable that "
    "turns during the exposure (turn slower, expose shorter), angles that jitter (look at the drive and its encoder), "
    "a surface as the saw left it or worn corners (plane it), a drawing that is not its shape (measure it, "
    "draw it anew)",
    ResidualPlace.BESIDE: "beside the phantom's shadow, as from another body in the beam (a second board, a support, "
    "a hand): take it away, and repeat the scan",
    ResidualPlace.SHADOW: "inside the phantom's shadow, which has several causes: wood that is not uniform (use one "
    "without knots, evenly dry), scatter and beam hardening (collimate and filter the beam), flat fields that no "
    "longer fit (take new ones), rows that show something else (check the rows)",
}
SCALE_CURES = {
    ScaleSource.SIZE: "most of it is the phantom's size tolerance, so measure the phantom and give a smaller one "
    "(size_tolerance of its drawing, or size_tolerance_percent)",
    ScaleSource.NOISE: "most of it is the error of R/SDD, so use more views, more rows, a longer exposure or a larger "
    "phantom",
    ScaleSource.ASPECT: "the phantom's two directions differ from its drawing's, so measure it along both and draw it "
    "anew, or give the direction that is right (true_axis)",
}


@dataclass(frozen=True)
class Judgement:
    """Status, verdicts and reasons of a calibration, the worst reason first.

    Attributes
    ----------
    verdict : Verdict
        Verdict on the rays among themselves, and on the image's millimetres.
    rays_verdict : Verdict
        Verdict on the rays among themselves alone.
    """

    status: CalibrationStatus
    verdict: Verdict
    rays_verdict: Verdict
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class JudgementLimits:
    """The tolerances of a calibration, the scanner's known r_S, and the largest h_S that its bounds allow, if any."""

    tolerance_mm: float
    scale_percent: float
    source_to_cor_mm: float
    source_shift_mm: float = math.inf

    @classmethod
    def of(cls, task: CalibrationTask) -> "JudgementLimits":
        """Return the limits of a task."""
        shift_mm = math.inf if task.bounds is None else max(map(abs, task.bounds.source_shift_mm))
        return cls(task.tolerance_mm, task.scale_tolerance_percent, task.scanner.source_to_cor_mm, shift_mm)


@dataclass(frozen=True)
class Findings:
    """The fitted geometry, its uncertainties and its rivals; a method without error bars finds no more."""

    fit: FittedModel
    source_distance: SourceDistance
    alternatives: Alternatives
    scale: ScaleUncertainty
    error_bars: ErrorBars | None


@dataclass(frozen=True)
class Evidence(Findings):
    """The findings of a method with error bars, by which a calibration is judged."""

    fit: Fit
    error_bars: ErrorBars
    residual: ResidualAnalysis
    theta_in_bounds: bool
    witness: LogWitness | None = None

    @property
    def structure(self) -> Structure | None:
        """Structure in the residual beyond noise, where there is enough to be reported."""
        structure = self.residual.structure
        return structure if structure is not None and structure.share > REPORTED else None


class Degree(Enum):
    """The severity of a remark, the worst first."""

    FAIL = "fail"
    WATCH = "watch"
    NOTE = "pass"


@dataclass(frozen=True)
class Remark:
    """A reason, and the calibration's status because of this reason, if the reason decides a status.

    Attributes
    ----------
    of_scale : bool
        The remark concerns the image's millimetres alone: the rays may be right among themselves.
    """

    degree: Degree
    reason: str
    status: CalibrationStatus | None = None
    of_scale: bool = False


def judge(evidence: Evidence, limits: JudgementLimits) -> Judgement:
    """Judge by the evidence: the worst remark gives the verdict, the first remark with a status gives the status."""
    return combined([remark for kind in KINDS for remark in kind(evidence, limits)])


def combined(remarks: list[Remark]) -> Judgement:
    """Combine all remarks into a judgement."""
    rays = [remark for remark in remarks if not remark.of_scale]
    status = next((remark.status for remark in remarks if remark.status is not None), CalibrationStatus.CALIBRATED)
    reasons = tuple(remark.reason for degree in Degree for remark in remarks if remark.degree is degree)
    return Judgement(status, _worst(remarks), _worst(rays), reasons)


def _worst(remarks: list[Remark]) -> Verdict:
    degrees = {remark.degree for remark in remarks}
    return "fail" if Degree.FAIL in degrees else "watch" if Degree.WATCH in degrees else "pass"


def _convergence(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    if not evidence.fit.converged:
        cure = (
            "compare the report's residual with the drawing for what the drawing does not have, check the rows, and "
            "use more views if there are few"
        )
        yield Remark(Degree.FAIL, f"the fit did not converge: {cure}", CalibrationStatus.NOT_CONVERGED)


def _effects(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Report effects that should not be there, and effects that were found and not fitted."""
    for effect in evidence.residual.effects:
        if effect.ray_error_mm <= MATTERS * limits.tolerance_mm or (effect.fitted and not effect.remedy):
            continue
        puts_off = f"the rays {'would be' if effect.fitted else 'are'} off by {effect.ray_error_mm:.2g} mm"
        fitted = (
            f"it was fitted, and {puts_off} without that" if effect.fitted else f"it was not fitted, and {puts_off}"
        )
        yield Remark(Degree.NOTE, "; ".join(filter(None, [effect.sentence, fitted, effect.remedy])))


def _second_witness(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the log next to the phantom contradicts the phantom, by more than matters."""
    witness = evidence.witness
    if witness is None:
        return
    if witness.other_sense:
        yield Remark(
            Degree.WATCH,
            "the log's rays agree only if the scanner turns the other way: check the sign of the angles and "
            "from which end the phantom was seen",
        )
    elif witness.agreement is Agreement.DISAGREE:
        matters = witness.ray_change_mm > MATTERS * limits.tolerance_mm
        yield Remark(Degree.WATCH if matters else Degree.NOTE, _disagreement(witness))


def _other_hypothesis(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Check whether another side or sense of rotation explains the scan as well."""
    hypotheses = evidence.alternatives.hypotheses
    if len(hypotheses) > 1 and _undecided(evidence.alternatives, hypotheses[1].relative_residual):
        best, second = hypotheses[:2]
        yield Remark(
            Degree.WATCH,
            f"the scan does not tell {best.handedness.value}, {best.rotation.value} from {second.handedness.value}, "
            f"{second.rotation.value}: give the right one, or use a phantom without symmetry",
            CalibrationStatus.AMBIGUOUS_HANDEDNESS,
        )


def _first_angle(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Check whether another first angle explains the scan as well."""
    turned = evidence.alternatives.turned
    if turned is not None and _undecided(evidence.alternatives, turned.relative_residual):
        yield Remark(
            Degree.WATCH,
            f"the phantom looks the same turned by {turned.by_deg:.0f} degrees, so the first angle may be off by as "
            "much: use a phantom without symmetry",
            CalibrationStatus.AMBIGUOUS_TURN,
        )


def _held_distance(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether a free source distance below r_S is noise or a contradiction."""
    distance, r_s = evidence.source_distance, limits.source_to_cor_mm
    if not distance.held:
        return
    free_mm = distance.unconstrained_mm
    statement = f"the free fit put the source at {free_mm:.2f} mm, nearer than source_to_cor_mm {r_s:.2f}"
    if distance.deficit_deviations > CONTRADICTION:
        yield Remark(
            Degree.FAIL,
            f"{statement} by {distance.deficit_deviations:.0f} standard deviations: the phantom is larger than its "
            f"drawing, by {r_s / free_mm - 1.0:.1%} or more, or that constant is wrong: measure both",
            CalibrationStatus.INCONSISTENT_SCALE,
        )
    else:
        yield Remark(
            Degree.NOTE,
            f"{statement}, for which no theta exists: the source distance was held there, and the source shift is 0 "
            "within the noise",
        )


def _precision(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the predicted ray error's upper bound holds the tolerance with 95 % (ISO 14253-1).

    Where only the RMS is within the tolerance, the verdict is "watch".
    """
    predicted, tolerance_mm = evidence.error_bars.predicted_ray_error, limits.tolerance_mm
    if predicted.upper_95_mm <= tolerance_mm:
        return
    structured = evidence.structure is not None
    of_the_model = structured and evidence.error_bars.deviation_ratio > MODEL_DOMINATED
    cure = (
        "the model does not fit the scan, as another reason states, and more views alone will not help"
        if of_the_model
        else "use more views, more rows or a longer exposure"
    )
    yield Remark(
        Degree.WATCH if predicted.rms_mm <= tolerance_mm else Degree.FAIL,
        f"the predicted ray error is {predicted.rms_mm:.3f} mm, with 95 % below {predicted.upper_95_mm:.3f} mm, where "
        f"{tolerance_mm:.3f} mm is allowed: {cure}",
        CalibrationStatus.IMPRECISE,
    )


def _structured_residual(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Report the structure that the model leaves of the sinogram."""
    structure = evidence.structure
    if structure is not None:
        yield Remark(
            Degree.NOTE,
            f"the phantom's model leaves {structure.share:.1%} of the sinogram unexplained, and not as noise, most of "
            f"it {CAUSES[structure.place]}",
        )


def _bounds(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check the scanner's bounds of theta; a phantom smaller than its drawing shows as a source shift beyond them."""
    if evidence.theta_in_bounds:
        return
    found_mm, r_s = evidence.fit.frame.source_distance_mm, limits.source_to_cor_mm
    largest_mm = math.hypot(r_s, limits.source_shift_mm)
    if found_mm > largest_mm:
        yield Remark(
            Degree.WATCH,
            f"the source shift would be {math.sqrt(found_mm**2 - r_s**2):.0f} mm, where the scanner's bounds allow "
            f"{limits.source_shift_mm:.0f} mm, as with {size_by_distance(found_mm, largest_mm)} or more: measure the "
            "phantom and check which one was scanned, then check source_to_cor_mm and the bounds",
        )
    else:
        yield Remark(
            Degree.WATCH,
            "theta lies outside the scanner's bounds: check the scanner's constants, or widen the bounds",
        )


def _source_shift(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    if not evidence.source_distance.held and not evidence.error_bars.source_shift_resolved:
        yield Remark(
            Degree.NOTE,
            "the source shift is not resolved from 0, so theta has no standard deviations; the rays have",
        )


def _scale(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the image's millimetres are known well enough: no residual shows a common scale."""
    scale = evidence.scale
    if scale.percent_95 > limits.scale_percent:
        yield Remark(
            Degree.WATCH,
            f"the image's millimetres are known to {scale.percent_95:.2g} % (95 %) where {limits.scale_percent:.2g} % "
            f"is allowed: {SCALE_CURES[scale.largest]}",
            of_scale=True,
        )


# The order of the statuses, the worst first.
KINDS: tuple[Callable[[Evidence, JudgementLimits], Iterator[Remark]], ...] = (
    _convergence,
    _effects,
    _second_witness,
    _other_hypothesis,
    _first_angle,
    _held_distance,
    _precision,
    _structured_residual,
    _bounds,
    _source_shift,
    _scale,
)


def _undecided(alternatives: Alternatives, relative_residual: float) -> bool:
    """Return whether the best fit's log-likelihood hardly exceeds a fit's with this relative residual."""
    behind = alternatives.log_likelihood_behind(relative_residual)
    return behind is not None and behind < DECISIVE


def _disagreement(witness: LogWitness) -> str:
    """Return a sentence: by how much log and phantom differ, which of the two is wrong, and what to do."""
    column, tilt = witness.difference.values
    differ = (
        f"the log beside the phantom puts the COR {column:+.3f} mm and the tilt {math.degrees(tilt):+.3f} degrees from "
        "where the phantom puts them, beyond both error bars"
    )
    jump = witness.log.movement
    match witness.moved:
        case MovedBody.LOG if jump is not None:
            return (
                f"{differ}: the log moved alone, by {jump.by_mm:.2g} mm at view {jump.view}; the phantom's were taken"
            )
        case MovedBody.BOTH if jump is not None:
            return (
                f"{differ}: both moved, the log by {jump.by_mm:.2g} mm at view {jump.view}: fasten the log on the "
                "turntable and repeat the scan"
            )
        case None:
            return (
                f"{differ}: so few views do not tell which of them moved, or whether the flat field has an error "
                "behind the log; the phantom's were taken: fasten both and repeat the scan, with 120 views or more"
            )
        case _ if jump is None:
            return f"{differ}: the phantom slipped, and the log's were taken: fasten the phantom and repeat the scan"
    return (
        f"{differ}: the log stood still, so the phantom slipped, or it is not as drawn; the log's were taken: fasten "
        "the phantom and repeat the scan"
    )
