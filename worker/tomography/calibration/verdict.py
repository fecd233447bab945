"""Pass, watch or fail, each with reasons that a technician can act on."""

import math
from dataclasses import dataclass

from worker.tomography.calibration.calibration import HypothesisReport
from worker.tomography.calibration.refine import Fit

# Beyond this many times the tolerance a calibration fails; between, it is to be watched.
FAIL_FACTOR = 2.5
# Log-likelihood advantage over the next hypothesis below which the choice is not decisive.
DECISIVE = 10.0
# A structured residual above this share of the sinogram means that the model is not the scan's.
STRUCTURED = 0.03
# Inflation of the covariance from which the residual counts as structured.
CORRELATED = 3.0


@dataclass(frozen=True)
class TurnedRival:
    """The best fit of the same hypothesis with the phantom turned."""

    by_deg: float
    relative_residual: float


def judge(
    *,
    predicted_mm: float,
    tolerance_mm: float,
    fit: Fit,
    inflation: float,
    hypotheses: tuple[HypothesisReport, ...],
    turned: TurnedRival | None,
    samples: int,
    source_shift_resolved: bool,
    theta_in_bounds: bool,
    unconstrained_mm: float | None,
    source_to_cor_mm: float,
) -> tuple[str, tuple[str, ...]]:
    """The verdict and its reasons, worst first."""
    fails, watches, notes = [], [], []
    if not fit.converged:
        fails.append("the fit did not converge: repeat it with more views or another seed")
    if predicted_mm > FAIL_FACTOR * tolerance_mm:
        fails.append(_imprecise(predicted_mm, tolerance_mm))
    elif predicted_mm > tolerance_mm:
        watches.append(_imprecise(predicted_mm, tolerance_mm))
    if fit.relative_residual > STRUCTURED and inflation > CORRELATED:
        watches.append(
            f"the phantom's model leaves {fit.relative_residual:.1%} of the sinogram unexplained, and not as noise: "
            "check the phantom's drawing and size, beam hardening and the rows chosen"
        )
    if not theta_in_bounds:
        watches.append("theta lies outside the scanner's bounds: check the scanner's constants, or widen the bounds")
    best = hypotheses[0]

    def advantage(rival: float) -> float:
        """Log-likelihood by which the best hypothesis beats another's relative residual."""
        return samples / inflation * math.log(max(rival, 1e-12) / max(best.relative_residual, 1e-12))

    if len(hypotheses) > 1 and advantage(hypotheses[1].relative_residual) < DECISIVE:
        second = hypotheses[1]
        watches.append(
            f"the scan does not tell {best.handedness.value}, {best.rotation.value} from {second.handedness.value}, "
            f"{second.rotation.value}: say which it is, or use a phantom without symmetry"
        )
    if turned is not None and advantage(turned.relative_residual) < DECISIVE:
        watches.append(
            f"the phantom looks the same turned by {turned.by_deg:.0f} degrees, so the first angle may be off by as "
            "much: use a phantom without symmetry"
        )
    if unconstrained_mm is not None:
        notes.append(
            f"the free fit put the source at {unconstrained_mm:.2f} mm, nearer than source_to_cor_mm "
            f"{source_to_cor_mm:.2f}, for which no theta exists: the source distance was held there, "
            "and the source shift is 0 within the noise"
        )
    elif not source_shift_resolved:
        notes.append("the source shift is not resolved from 0, so theta has no standard deviations; the rays have")
    verdict = "fail" if fails else "watch" if watches else "pass"
    return verdict, tuple(fails + watches + notes)


def _imprecise(predicted_mm: float, tolerance_mm: float) -> str:
    return (
        f"the predicted ray error is {predicted_mm:.3f} mm where {tolerance_mm:.3f} mm is allowed: "
        "use more views, more rows or a longer exposure"
    )
