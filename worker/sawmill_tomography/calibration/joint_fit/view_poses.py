"""Poses of single views, where the object is turned between passages and so has another place in each view.

The roll of each view, and its shifts across and along the beam, are random effects with one size each, which has no
zero: restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971, 545-554). Each belongs to one view
only, so they are eliminated view by view.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sawmill_tomography.calibration.covariance import scaled_inverse, unit_scale
from sawmill_tomography.calibration.fit import OnStep
from sawmill_tomography.calibration.joint_fit.groups import MOTIONS
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, ViewGrams
from sawmill_tomography.calibration.joint_fit.scan_model import POSE, ScanModel
from sawmill_tomography.calibration.joint_fit.steps import stepped
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# Effects of an object that turns while it is scanned.
OF_TURNING = MOTIONS | {Adjustment.ANGLE_JITTER, Adjustment.ROTATION_DURING_EXPOSURE}
# A step of the poses is negligible when it moves the object's rim by less than this: for a scan almost free of noise it
# may be many standard deviations.
LEAST_MOVE_MM = 0.003


@dataclass(frozen=True)
class PoseSizes:
    """Standard deviations of the views' poses: of roll, and of shifts across and along the beam."""

    roll_rad: float
    across_mm: float
    along_mm: float

    @property
    def shift_mm(self) -> float:
        """Root mean square of both shifts, mm."""
        return math.sqrt(0.5 * (self.across_mm**2 + self.along_mm**2))

    def precision(self, model: ScanModel) -> FloatArray:
        """Return the inverse covariance (views, 3, 3) of the poses in the order of `POSE`."""
        axes = beam_axes(model)
        own = np.array([self.roll_rad, self.across_mm, self.along_mm])
        return np.asarray(axes / own**2 @ np.swapaxes(axes, 1, 2))


def beam_axes(model: ScanModel) -> FloatArray:
    """Return the changes (views, 3, 3) of `POSE` by a roll and by shifts across and along the beam."""
    beta = model.data.angles_rad + model.x[FitParameter.PSI] + model.pose[:, 0]
    axes = np.zeros((len(beta), 3, 3))
    axes[:, 0, 0] = 1.0
    axes[:, 1, 1] = axes[:, 2, 2] = np.cos(beta)
    axes[:, 2, 1] = np.sin(beta)
    axes[:, 1, 2] = -axes[:, 2, 1]
    return axes


def likeliest_sizes(model: ScanModel, grams: ViewGrams, columns: Sequence[Column]) -> tuple[PoseSizes, float]:
    """Return the likeliest sizes of the views' poses next to these columns, and the variance of a sample."""
    base, own = slice(len(columns)), slice(len(columns), None)
    products, scores = grams.of_columns([*columns, *map(Column.of, POSE)])
    within, crossed, normal = products[:, own, own], products[:, base, own], products[:, base, base].sum(axis=0)
    # The scores and the power where all poses are 0.
    zero = scores + (products[:, :, own] @ model.pose[..., None])[..., 0]
    power = grams.power + float((model.pose * (scores + zero)[:, own]).sum())
    scale = unit_scale(normal)

    def left(precision: FloatArray | float) -> tuple[FloatArray, float]:
        inverse = np.linalg.pinv(within + precision, rcond=1e-12, hermitian=True)
        taken = crossed @ inverse
        of_base = normal - np.einsum("vni,vmi->nm", taken, crossed)
        rest = zero[:, base].sum(axis=0) - np.einsum("vni,vi->n", taken, zero[:, own])
        explained = float(np.einsum("vi,vij,vj->", zero[:, own], inverse, zero[:, own]))
        return of_base, power - explained - float(rest @ scaled_inverse(of_base) @ rest)

    variance = left(0.0)[1] / max(grams.samples - 3.0 * len(scores) - len(columns), 1.0)

    def cost(logarithms: FloatArray) -> float:
        precision = variance * PoseSizes(*np.exp(logarithms)).precision(model)
        of_base, remaining = left(precision)
        determinants = np.linalg.slogdet(within + precision)[1] - np.linalg.slogdet(precision)[1]
        of_fixed = np.linalg.slogdet(of_base * np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))[1]
        return 0.5 * (float(determinants.sum() + of_fixed) + remaining / variance)

    # In rad and mm no size is outside of these bounds.
    best = scipy.optimize.minimize(cost, np.full(3, -3.0), method="L-BFGS-B", bounds=[(-11.5, 3.0)] * 3)
    return PoseSizes(*np.exp(best.x).tolist()), variance


def with_view_poses(model: ScanModel, columns: Sequence[Column], rounds: int, on_step: OnStep) -> ScanModel:
    """Find the views' poses next to these columns alone, in twice this number of rounds at most."""
    model = _stepped_often(model, columns, rounds, on_step)
    return _stepped_often(_with_other_rolls(model, columns, rounds // 3, on_step), columns, rounds, on_step)


def _with_other_rolls(model: ScanModel, columns: Sequence[Column], rounds: int, on_step: OnStep) -> ScanModel:
    """Take another roll in views that have two likely ones: a side along the rays looks alike turned either way."""
    grams = ViewGrams(model)
    sizes, variance = likeliest_sizes(model, grams, columns)

    def cost(at: ScanModel) -> FloatArray:
        prior = np.einsum("vi,vij,vj->v", at.pose, variance * sizes.precision(at), at.pose)
        return np.asarray((grams.weights * at.residual**2).sum(axis=1) + prior)

    best = model
    for deviations in (-1.5, 1.5):
        other = replace(model, pose=model.pose + deviations * sizes.roll_rad * np.eye(3)[0])
        for _ in range(rounds):
            on_step()
            there = ViewGrams(other)
            project_out_poses(other, there, sizes, variance)
            other = replace(other, pose=other.pose + there.of_each_view([], POSE)[0])
        best = replace(best, pose=np.where((cost(other) < cost(best))[:, None], other.pose, best.pose))
    return best


def _stepped_often(model: ScanModel, columns: Sequence[Column], rounds: int, on_step: OnStep) -> ScanModel:
    """Take steps of these columns and all poses until a step is small."""
    for _ in range(rounds):
        on_step()
        grams = ViewGrams(model)
        project_out_poses(model, grams, *likeliest_sizes(model, grams, columns))
        system = grams.system(columns)
        change = system.inverse(range(len(columns))) @ system.score
        of_poses = pose_change(grams, columns, change)
        model, share = stepped(model, system, change, grams, of_poses=of_poses)
        if share in (0.0, 1.0) and share * np.abs(of_poses * [model.drawing.radius_mm, 1.0, 1.0]).max() < LEAST_MOVE_MM:
            break
    return model


def project_out_poses(model: ScanModel, grams: ViewGrams, sizes: PoseSizes, variance: float) -> None:
    """Project out the poses of single views, which scatter with these sizes."""
    grams.project_out(POSE, variance * sizes.precision(model), model.pose)


def pose_change(grams: ViewGrams, columns: Sequence[Column], change: FloatArray) -> FloatArray:
    """Return the change (views, 3) of the poses that belongs to a change of these columns."""
    own, taken, _ = grams.of_each_view(columns, POSE)
    return own - taken @ change
