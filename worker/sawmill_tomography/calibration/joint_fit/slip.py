"""Angles that are wrong: a phantom that slips or an angle that jumps at a view, and angles that scatter."""

import math
from collections.abc import Sequence

import numpy as np

from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.joint_fit.effects import Effect, in_the_laboratory
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, System
from sawmill_tomography.calibration.joint_fit.outliers import BY_FAR
from sawmill_tomography.calibration.joint_fit.scan_model import POSE, ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.statistics import robust_deviation
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import EffectMessage

# A slip needs at least as many views as it has unknowns, and this share of all views, before and after.
SHARE_OF_VIEWS = 1 / 24
# The number of views at which a slip that the scan hides may lie: a small one is not placed more precisely.
PLACES = 8
# A slip is a jump of the angles when the phantom's shift is less than this share of the turn at the phantom's rim.
TURN_ALONE = 0.1


def slip_at(view: int) -> Effect:
    """Return the effect of a slip from this view on."""

    def columns(model: ScanModel) -> tuple[Column, ...]:
        after = (np.arange(len(model.data.angles_rad)) >= view).astype(np.float64)
        return tuple(Column(((term, after),)) for term in POSE)

    def reason(model: ScanModel, sizes: FloatArray) -> Reason:
        turn, *move = sizes
        by_mm, by_deg = math.hypot(*move), math.degrees(abs(turn))
        if by_mm < TURN_ALONE * abs(turn) * model.drawing.radius_mm:
            return EffectMessage.ANGLES_JUMP(view=view, jump_deg=by_deg)
        return EffectMessage.SLIP(view=view, slip_mm=by_mm, slip_deg=by_deg)

    return Effect(Adjustment.SLIP, columns, reason)


def jump_at(view: int) -> Effect:
    """Return the effect of source, turntable or detector that jump at this view; the geometry is the mean one."""

    def columns(model: ScanModel) -> tuple[Column, ...]:
        after = (np.arange(len(model.data.angles_rad)) >= view).astype(np.float64)
        return in_the_laboratory(model, [after - after.mean()])

    return Effect(
        Adjustment.SLIP, columns, lambda _, sizes: EffectMessage.SCANNER_JUMP(view=view, jump_mm=math.hypot(*sizes))
    )


def places_of_slips(views: int) -> list[int]:
    """Return views, spread evenly, at which a slip may lie; none for too few views."""
    least = fewest(views)
    return sorted({round(view) for view in np.linspace(least, views - least, PLACES)}) if views >= 2 * least else []


def fewest(views: int) -> int:
    """Return the least number of views before and after a slip, and between two."""
    return max(len(POSE), round(SHARE_OF_VIEWS * views))


def likeliest_slip(columns: Sequence[Column], grams: FloatArray, scores: FloatArray) -> int | None:
    """Find the view at which a slip explains most in addition to the columns of a fit; None for too few views.

    `grams` (views, columns, columns), `scores` (views, columns): inner products of each view. Stripes are ignored: what
    is subtracted for stripes belongs to no single view.
    """
    views = len(scores)
    least = fewest(views)
    if views < 2 * least:
        return None
    pose = [next(i for i, column in enumerate(columns) if column.term is term) for term in POSE]
    inverse = scaled_inverse(grams.sum(axis=0))
    of_pose = grams[:, pose]
    rest = scores[:, pose] - of_pose @ (inverse @ scores.sum(axis=0))
    after = np.cumsum(rest[::-1], axis=0)[::-1][least : views - least + 1]
    cross = np.cumsum(of_pose[::-1], axis=0)[::-1][least : views - least + 1]
    matrix = cross[:, :, pose] - cross @ inverse @ np.swapaxes(cross, 1, 2)
    solved = (np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ after[..., None])[..., 0]
    return least + int(np.einsum("nt,nt->n", after, solved).argmax())


def angle_scatter(system: System, change: FloatArray, variance: float) -> float:
    """Estimate the variance of the views' angles, rad^2; 0 where noise or a wrong model explains the scores.

    Noise does not explain the scatter when it is larger by `BY_FAR` standard deviations. An error of the model does not
    explain the scatter when neighbouring views share less than half of it, u_c scatters independently by less than
    half, the median view has more than half, and the scatter explains most of the structured residual.
    """
    places = [next(i for i, c in enumerate(system.columns) if c.term is term) for term in (Term.PSI, Term.U_C)]
    psi, u_c = 0, 1
    grams, scores = system.of_views(np.eye(len(change))[:, places], change)
    own = grams[:, psi, psi]
    seen = own > 1e-9 * own.max()
    if not seen.any() or variance <= 0.0:
        return 0.0
    own, cross, score = own[seen], grams[seen, psi, u_c], scores[seen, psi]
    unit = score / np.sqrt(own * variance)
    excess = float((unit**2 - 1.0).sum())
    remaining = scores[seen, u_c] - cross / own * score
    along = grams[seen, u_c, u_c]
    # Only rounding remains where turning and shifting the view have the same effect.
    apart = np.maximum(along - cross**2 / own, np.finfo(np.float64).eps * along.max())
    column_excess = float((remaining**2 / (apart * variance) - 1.0).sum())
    # Where a model is finer than the scan, one view with an edge along the rays may have most of the scatter.
    usual = robust_deviation(unit) ** 2 - 1.0
    chance = BY_FAR * math.sqrt(2.0 * unit.size)
    if (
        excess < chance
        or 2.0 * excess * variance < system.structured - float(change @ system.score)
        or 2.0 * usual * unit.size < excess
        or 2.0 * abs(float((unit[1:] * unit[:-1]).sum())) > excess
        or 2.0 * column_excess > max(excess, chance)
    ):
        return 0.0
    return float((score**2 - own * variance).sum() / (own**2).sum())
