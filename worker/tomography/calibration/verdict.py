"""Status and verdict, with reasons that name a likely cause and what to do."""

import math
from dataclasses import dataclass

from worker.tomography.calibration.calibration import HypothesisReport, Status
from worker.tomography.calibration.refine import Fit
from worker.tomography.calibration.structure import Place, Structure

# Beyond this many times the tolerance a calibration fails; between, it is to be watched.
FAIL_FACTOR = 2.5
# Log-likelihood advantage over the next hypothesis below which the choice is not decisive.
DECISIVE = 10.0
# What the residual holds beside noise, as a share of the sinogram: above the first it is told, above the second the
# model is not the scan's and the calibration is to be watched.
TOLD, STRUCTURED = 0.001, 0.005
# Error bars that the residual widened by more than this are wide because of the model, not of the noise.
WIDENED = 2.0

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

    status: Status
    verdict: str
    reasons: tuple[str, ...]


def judge(
    *,
    predicted_mm: float,
    tolerance_mm: float,
    fit: Fit,
    inflation: float,
    widening: float,
    structure: Structure | None,
    hypotheses: tuple[HypothesisReport, ...],
    turned: TurnedRival | None,
    samples: int,
    source_shift_resolved: bool,
    theta_in_bounds: bool,
    unconstrained_mm: float | None,
    source_to_cor_mm: float,
) -> Judgement:
    """Status, verdict and reasons; `structure` is None where the residual is noise."""
    statuses: list[Status] = []
    fails: list[str] = []
    watches: list[str] = []
    notes: list[str] = []
    if not fit.converged:
        statuses.append(Status.NOT_CONVERGED)
        fails.append("the fit did not converge: repeat it with more views or another seed")
    best = hypotheses[0]

    def undecided(rival: float) -> bool:
        """Whether the best hypothesis's log-likelihood hardly beats another's, told by its relative residual."""
        advantage = samples / inflation * math.log(max(rival, 1e-12) / max(best.relative_residual, 1e-12))
        return advantage < DECISIVE

    if len(hypotheses) > 1 and undecided(hypotheses[1].relative_residual):
        statuses.append(Status.AMBIGUOUS_HANDEDNESS)
        second = hypotheses[1]
        watches.append(
            f"the scan does not tell {best.handedness.value}, {best.rotation.value} from {second.handedness.value}, "
            f"{second.rotation.value}: say which it is, or use a phantom without symmetry"
        )
    if turned is not None and undecided(turned.relative_residual):
        statuses.append(Status.AMBIGUOUS_TURN)
        watches.append(
            f"the phantom looks the same turned by {turned.by_deg:.0f} degrees, so the first angle may be off by as "
            "much: use a phantom without symmetry"
        )
    if predicted_mm > tolerance_mm:
        statuses.append(Status.IMPRECISE)
        imprecise = _imprecise(predicted_mm, tolerance_mm, of_the_model=widening > WIDENED)
        if predicted_mm > FAIL_FACTOR * tolerance_mm:
            fails.append(imprecise)
        else:
            watches.insert(0, imprecise)
    if structure is not None and structure.share > TOLD:
        (watches if structure.share > STRUCTURED else notes).append(
            f"the phantom's model leaves {structure.share:.1%} of the sinogram unexplained, and not as noise, most of "
            f"it {CAUSES[structure.place]}"
        )
    if not theta_in_bounds:
        watches.append("theta lies outside the scanner's bounds: check the scanner's constants, or widen the bounds")
    if unconstrained_mm is not None:
        notes.append(
            f"the free fit put the source at {unconstrained_mm:.2f} mm, nearer than source_to_cor_mm "
            f"{source_to_cor_mm:.2f}, for which no theta exists: the source distance was held there, "
            "and the source shift is 0 within the noise"
        )
    elif not source_shift_resolved:
        notes.append("the source shift is not resolved from 0, so theta has no standard deviations; the rays have")
    verdict = "fail" if fails else "watch" if watches else "pass"
    return Judgement(next(iter(statuses), Status.CALIBRATED), verdict, tuple(fails + watches + notes))


def _imprecise(predicted_mm: float, tolerance_mm: float, *, of_the_model: bool) -> str:
    cure = (
        "the model is not the scan's, as said below, and more views alone will not help"
        if of_the_model
        else "use more views, more rows or a longer exposure"
    )
    return f"the predicted ray error is {predicted_mm:.3f} mm where {tolerance_mm:.3f} mm is allowed: {cure}"
