"""Status, verdict and reasons: each kind of evidence is one function that yields remarks; the worst remarks decide."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum

from sawmill_tomography.calibration.alternatives import Alternatives
from sawmill_tomography.calibration.covariance import CHANCE
from sawmill_tomography.calibration.fit import Fit, FittedModel
from sawmill_tomography.calibration.joint_fit.residual_analysis import ResidualAnalysis
from sawmill_tomography.calibration.joint_fit.residual_statistics import ErrorBars
from sawmill_tomography.calibration.joint_fit.structure import ResidualPlace, Structure
from sawmill_tomography.calibration.scale import ScaleSource, ScaleUncertainty, size_by_distance
from sawmill_tomography.calibration.search.misfit import LARGEST_MAGNIFICATION
from sawmill_tomography.calibration.second_witness import LogWitness
from sawmill_tomography.calibration.sinogram_data import counted_radius_mm
from sawmill_tomography.calibration.source_distance import SourceDistance
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import SourceFrame
from sawmill_tomography.preparing.line_integrals import MOST_DEAD
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary import WIDEST_CELL_MM, Agreement, CalibrationStatus, MovedBody, Verdict
from sawmill_vocabulary.calibration_messages import CalibrationMessage, ResidualMessage
from sawmill_vocabulary.messages import Reason

# Structure in the residual is reported above this share of the sinogram. Unless the same cells are wrong in all views,
# structure does not prevent a pass: its effect on the rays is in the error bars, and the error bars decide.
REPORTED = 0.001
# An effect is a reason where the rays would be off by more than this share of the tolerance without it.
MATTERS = 0.1
# What no scanner of logs has, as wider cells than `WIDEST_CELL_MM`: a detector further away (mm), or a magnification
# larger than those searched. A wrong unit of the cells' distance, or binned pixels, leave the rays right and make all
# lengths on the detector wrong.
LARGEST_SDD_MM = 10_000.0

_RESIDUALS = {
    ResidualPlace.STANDING: ResidualMessage.STANDING,
    ResidualPlace.VIEWS: ResidualMessage.VIEWS,
    ResidualPlace.CELLS: ResidualMessage.CELLS,
    ResidualPlace.EDGES: ResidualMessage.EDGES,
    ResidualPlace.BESIDE: ResidualMessage.BESIDE,
    ResidualPlace.SHADOW: ResidualMessage.SHADOW,
}
_SCALES = {
    ScaleSource.SIZE: CalibrationMessage.SCALE_SIZE,
    ScaleSource.NOISE: CalibrationMessage.SCALE_NOISE,
    ScaleSource.ASPECT: CalibrationMessage.SCALE_ASPECT,
}


@dataclass(frozen=True)
class Judgement:
    """Status, verdicts and reasons of a calibration, the worst reason first."""

    status: CalibrationStatus
    verdict: Verdict  # verdict on the rays among themselves, and on the image's millimetres
    rays_verdict: Verdict  # verdict on the rays among themselves alone
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class JudgementLimits:
    """The tolerances of a calibration, what is known of the scanner, and the largest h_S that its bounds allow, if any.

    `log_radius_mm` is the radius of the largest log, or the phantom's.
    """

    tolerance_mm: float
    scale_percent: float
    source_to_cor_mm: float
    source_shift_mm: float = math.inf
    detector_pitch_mm: float = 0.0
    log_radius_mm: float = 0.0

    @classmethod
    def of(cls, task: CalibrationTask) -> "JudgementLimits":
        """Return the limits of a task."""
        shift_mm = math.inf if task.bounds is None else max(map(abs, task.bounds.source_shift_mm))
        return cls(
            task.tolerance_mm,
            task.scale_tolerance_percent,
            task.scanner.source_to_cor_mm,
            shift_mm,
            task.scanner.detector_pitch_mm,
            counted_radius_mm(task.log_radius_mm, task.phantom),
        )


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
    saturated_share: float = 0.0
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
    """A reason, and the calibration's status because of this reason, if the reason decides a status."""

    degree: Degree
    reason: Reason
    status: CalibrationStatus | None = None
    of_scale: bool = False  # the remark concerns the image's millimetres alone: the rays may be right among themselves
    comes_first: bool = False


def judge(evidence: Evidence, limits: JudgementLimits) -> Judgement:
    """Judge by the evidence: the worst remark gives the verdict, the first remark with a status gives the status."""
    return combined([remark for kind in KINDS for remark in kind(evidence, limits)])


def combined(remarks: list[Remark]) -> Judgement:
    """Combine all remarks into a judgement."""
    rays = [remark for remark in remarks if not remark.of_scale]
    status = next((remark.status for remark in remarks if remark.status is not None), CalibrationStatus.CALIBRATED)
    ordered = sorted(remarks, key=lambda remark: (not remark.comes_first, list(Degree).index(remark.degree)))
    return Judgement(status, _worst(remarks), _worst(rays), tuple(remark.reason for remark in ordered))


def _worst(remarks: list[Remark]) -> Verdict:
    degrees = {remark.degree for remark in remarks}
    return "fail" if Degree.FAIL in degrees else "watch" if Degree.WATCH in degrees else "pass"


def saturation(saturated_share: float) -> Iterator[Remark]:
    """Check whether more cells are saturated than their neighbours can bridge."""
    if saturated_share > MOST_DEAD:
        shares = {"share_percent": 100.0 * saturated_share, "allowed_percent": 100.0 * MOST_DEAD}
        yield Remark(Degree.WATCH, CalibrationMessage.SATURATED(**shares), comes_first=True)


def implausible(frame: SourceFrame, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether a scanner of logs can have such a geometry."""
    behind_mm = frame.source_to_detector_mm - frame.source_distance_mm
    if behind_mm < limits.log_radius_mm:
        reason = CalibrationMessage.DETECTOR_IN_LOG(behind_mm=behind_mm, radius_mm=limits.log_radius_mm)
    elif frame.source_to_detector_mm > LARGEST_SDD_MM:
        far_mm = {"distance_mm": frame.source_to_detector_mm, "allowed_mm": LARGEST_SDD_MM}
        reason = CalibrationMessage.DETECTOR_FAR_AWAY(**far_mm)
    elif frame.magnification > LARGEST_MAGNIFICATION:
        times = {"magnification": frame.magnification, "allowed": LARGEST_MAGNIFICATION}
        reason = CalibrationMessage.MAGNIFICATION(**times)
    elif limits.detector_pitch_mm > WIDEST_CELL_MM:
        wide_mm = {"pitch_mm": limits.detector_pitch_mm, "allowed_mm": WIDEST_CELL_MM}
        reason = CalibrationMessage.WIDE_CELLS(**wide_mm)
    else:
        return
    yield Remark(Degree.WATCH, reason, comes_first=True)


def _convergence(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    if not evidence.fit.converged:
        yield Remark(Degree.FAIL, CalibrationMessage.NOT_CONVERGED(), CalibrationStatus.NOT_CONVERGED)


def _effects(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Report effects that should not be there, effects that were found and not fitted, and what moved far or often."""
    if evidence.residual.cells_misplaced:
        return  # such cells resemble effects that are not there
    jumps, may_be_mm = evidence.residual.jumps, evidence.error_bars.predicted_ray_error.upper_95_mm
    if jumps > 1 and may_be_mm > limits.tolerance_mm:
        yield Remark(Degree.WATCH, CalibrationMessage.MOVED_OFTEN(times=jumps, may_be_mm=may_be_mm))
    for effect in evidence.residual.effects:
        if 0.5 * effect.scanner_moved_mm > limits.tolerance_mm:
            yield Remark(Degree.NOTE, CalibrationMessage.SCANNER_MOVED(effect.reason, moved_mm=effect.scanner_moved_mm))
            continue
        needs_nothing = effect.fitted and not effect.reason.in_words().action
        if effect.ray_error_mm <= MATTERS * limits.tolerance_mm or needs_nothing:
            continue
        message = CalibrationMessage.EFFECT_FITTED if effect.fitted else CalibrationMessage.EFFECT_NOT_FITTED
        yield Remark(Degree.NOTE, message(effect.reason, off_mm=effect.ray_error_mm))


def _second_witness(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the log next to the phantom contradicts the phantom, by more than matters."""
    witness = evidence.witness
    if witness is None:
        return
    if witness.other_sense:
        yield Remark(Degree.WATCH, CalibrationMessage.LOG_IN_OTHER_SENSE())
    elif witness.agreement is Agreement.DISAGREE:
        matters = witness.ray_change_mm > MATTERS * limits.tolerance_mm
        yield Remark(Degree.WATCH if matters else Degree.NOTE, _disagreement(witness))


def _other_hypothesis(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Check whether another side or sense of rotation explains the scan as well."""
    hypotheses = evidence.alternatives.hypotheses
    if len(hypotheses) > 1 and evidence.alternatives.undecided(hypotheses[1].relative_residual):
        best, second = hypotheses[:2]
        yield Remark(
            Degree.WATCH,
            CalibrationMessage.AMBIGUOUS_SIDE(
                side=best.handedness.value,
                sense=best.rotation.value,
                other_side=second.handedness.value,
                other_sense=second.rotation.value,
            ),
            CalibrationStatus.AMBIGUOUS_HANDEDNESS,
        )


def _first_angle(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Check whether another first angle explains the scan as well."""
    turned = evidence.alternatives.turned
    if turned is not None and evidence.alternatives.undecided(turned.relative_residual):
        yield Remark(
            Degree.WATCH, CalibrationMessage.AMBIGUOUS_TURN(by_deg=turned.by_deg), CalibrationStatus.AMBIGUOUS_TURN
        )


def _held_distance(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether a free source distance below r_S is noise or a contradiction."""
    distance, r_s = evidence.source_distance, limits.source_to_cor_mm
    if not distance.held:
        return
    free_mm = distance.unconstrained_mm
    if distance.deficit_deviations > CHANCE:
        yield Remark(
            Degree.FAIL,
            CalibrationMessage.SCALE_CONTRADICTION(
                found_mm=free_mm,
                known_mm=r_s,
                deviations=distance.deficit_deviations,
                larger_percent=100.0 * (r_s / free_mm - 1.0),
            ),
            CalibrationStatus.INCONSISTENT_SCALE,
        )
    else:
        yield Remark(Degree.NOTE, CalibrationMessage.SOURCE_HELD(found_mm=free_mm, known_mm=r_s))


def _precision(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the upper bound holds the tolerance with 95 % (ISO 14253-1); watch where only the RMS does."""
    predicted, tolerance_mm = evidence.error_bars.predicted_ray_error, limits.tolerance_mm
    if predicted.upper_95_mm <= tolerance_mm:
        return
    # What the variance has beyond that for white noise is the model's: here more than half of the variance.
    of_the_model = evidence.structure is not None and evidence.error_bars.statistics.deviation_ratio**2 > 2.0
    message = CalibrationMessage.IMPRECISE_MODEL if of_the_model else CalibrationMessage.IMPRECISE
    yield Remark(
        Degree.WATCH if predicted.rms_mm <= tolerance_mm else Degree.FAIL,
        message(rms_mm=predicted.rms_mm, upper_mm=predicted.upper_95_mm, allowed_mm=tolerance_mm),
        CalibrationStatus.IMPRECISE,
    )


def _structured_residual(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Report the structure that the model leaves of the sinogram; cells that are wrong in all views fail."""
    structure = evidence.structure
    if structure is not None:
        reason = _RESIDUALS[structure.place](share_percent=100.0 * structure.share, **structure.cells)
        degree, status = (Degree.FAIL, CalibrationStatus.IMPRECISE) if structure.cells else (Degree.NOTE, None)
        yield Remark(degree, reason, status, comes_first=bool(structure.cells))


def _bounds(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check the scanner's bounds of theta; a phantom smaller than its drawing shows as a source shift beyond them."""
    if evidence.theta_in_bounds:
        return
    found_mm, r_s = evidence.fit.frame.source_distance_mm, limits.source_to_cor_mm
    largest_mm = math.hypot(r_s, limits.source_shift_mm)
    if found_mm > largest_mm:
        yield Remark(
            Degree.WATCH,
            CalibrationMessage.SHIFT_BEYOND_BOUNDS(
                shift_mm=math.sqrt(found_mm**2 - r_s**2),
                allowed_mm=limits.source_shift_mm,
                **size_by_distance(found_mm, largest_mm),
            ),
        )
    else:
        yield Remark(Degree.WATCH, CalibrationMessage.OUTSIDE_BOUNDS())


def _source_shift(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    if not evidence.source_distance.held and evidence.error_bars.theta_covariance is None:
        yield Remark(Degree.NOTE, CalibrationMessage.SHIFT_NOT_RESOLVED())


def _column(evidence: Evidence, _: JudgementLimits) -> Iterator[Remark]:
    """Report how well u_c is known where the mean of the views' shifts looks the same."""
    if evidence.residual.poses is not None:
        deviation_mm = evidence.error_bars.frame_deviation(evidence.fit.frame)[FitParameter.U_C]
        yield Remark(Degree.NOTE, CalibrationMessage.COLUMN_BY_VIEWS(column_mm=TWO_SIDED_95 * float(deviation_mm)))


def _scale(evidence: Evidence, limits: JudgementLimits) -> Iterator[Remark]:
    """Check whether the image's millimetres are known well enough: no residual shows a common scale."""
    scale = evidence.scale
    if scale.percent_95 > limits.scale_percent:
        yield Remark(
            Degree.WATCH,
            _SCALES[scale.largest](percent=scale.percent_95, allowed_percent=limits.scale_percent),
            of_scale=True,
        )


# The order of the statuses, the worst first.
KINDS: tuple[Callable[[Evidence, JudgementLimits], Iterator[Remark]], ...] = (
    lambda evidence, _: saturation(evidence.saturated_share),
    lambda evidence, limits: implausible(evidence.fit.frame, limits),
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
    _column,
    _scale,
)


def _disagreement(witness: LogWitness) -> Reason:
    """Return by how much log and phantom differ, which of the two is wrong, and what to do."""
    column, tilt = witness.difference.values
    differ = CalibrationMessage.LOG_DISAGREES(column_mm=column, tilt_deg=math.degrees(tilt))
    jump = witness.log.movement
    match witness.moved:
        case MovedBody.LOG if jump is not None:
            return CalibrationMessage.LOG_MOVED(differ, log_mm=jump.by_mm, view=jump.view)
        case MovedBody.BOTH if jump is not None:
            return CalibrationMessage.BOTH_MOVED(differ, log_mm=jump.by_mm, view=jump.view)
        case None:
            return CalibrationMessage.PHANTOM_OR_LOG_MOVED(differ)
        case _ if jump is None:
            return CalibrationMessage.PHANTOM_SLIPPED(differ)
    return CalibrationMessage.PHANTOM_SLIPPED_OR_DRAWN(differ)
