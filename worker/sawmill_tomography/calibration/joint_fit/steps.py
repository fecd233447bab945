"""A Gauss-Newton step: its length, the changed model, and how far it moves the geometry."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sawmill_tomography.calibration.covariance import pseudo_inverse
from sawmill_tomography.calibration.joint_fit.normal_equations import UNTRUSTED, Column, System, ViewGrams
from sawmill_tomography.calibration.joint_fit.scan_model import POSE, ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray

# A step is within the noise when it moves the geometry by less than this number of standard deviations, squared, and
# the whole fit gains less than as much for each of its unknowns.
MOVED = 25.0


def off_by(system: System, used: Sequence[int], change: FloatArray) -> float:
    """Compute how far a step moves the geometry, squared, in standard deviations for unit variance of a sample."""
    columns = system.columns
    own = [n for n, i in enumerate(used) if columns[i].parameter is not None]
    step = change[[used[n] for n in own]]
    return float(step @ pseudo_inverse(system.inverse(used)[np.ix_(own, own)], 1e-12) @ step)


def stepped(
    model: ScanModel, system: System, change: FloatArray, grams: ViewGrams, *, of_poses: FloatArray | float = 0.0
) -> tuple[ScanModel, float]:
    """Take the largest share of the step that does not raise the residual; return the model and the share.

    The residual may rise by the share `UNTRUSTED`, since the compared sum does not contain the random effects of the
    views, and by what the system expects: where a group leaves the fit, or its prior is narrower, the residual rises.
    The returned share is 0 where no share above `UNTRUSTED` is possible. `of_poses` (views, 3) is the step of the poses
    of single views.
    """
    share = 1.0
    while share >= UNTRUSTED:
        then = moved(model, system.columns, share * change)
        then = replace(then, pose=then.pose + share * of_poses)
        if then.view_gain and then.clears:
            then = then.with_view_gains(grams.weights)
        # A step that is far too long has no finite residual: it is halved as one that raises the residual is.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            exists = then.clears and bool((then.gain > 0.0).all())
            highest = grams.objective_at_model * (1.0 + UNTRUSTED) + max(system.rise(share * change), 0.0)
            if exists and grams.objective(then.residual) <= highest:
                return then, share
        share *= 0.5
    return model, 0.0


def moved(model: ScanModel, columns: Sequence[Column], change: FloatArray) -> ScanModel:
    """Return the model with each column changed by the given amount."""
    scalars: dict[int, float] = {}
    pose = np.zeros_like(model.pose)
    for column, size in zip(columns, change.tolist(), strict=True):
        if size == 0.0:
            continue
        if column.term is not None:
            scalars[column.term] = size
        else:
            for term, shape in column.parts:
                pose[:, POSE.index(Term(term))] += size * shape
    return model.moved(scalars, pose)
