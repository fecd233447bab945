"""Draws of the errors of a geometry and of the poses of the views it was fitted with, which compensate each other."""

import numpy as np

from sawmill_tomography.calibration.covariance import pseudo_inverse
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.motion_sets import DRAWS
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.residual_statistics import ResidualStatistics, terms_of_rays
from sawmill_tomography.calibration.joint_fit.scan_model import POSE
from sawmill_tomography.calibration.joint_fit.view_poses import beam_axes
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import ViewErrors


def view_errors(joint: JointFit, statistics: ResidualStatistics) -> ViewErrors | None:
    """Draw the errors of the geometry and of the views' poses; None where the object turns in one scan."""
    if joint.poses is None:
        return None
    rng = np.random.default_rng(0)
    order, used = terms_of_rays(joint), [joint.system.columns[place] for place in joint.used]
    own = [n for n, column in enumerate(used) if column.term in order]
    rows = [order.index(used[n].term) for n in own]
    rest = [n for n in range(len(used)) if n not in own]
    errors = np.zeros((DRAWS, len(order) + len(rest)))
    errors[:, : len(order)] = _drawn(statistics.ray_covariance, rng)
    # What the other columns' errors are next to these.
    plain = joint.system.inverse(joint.used) * joint.variance
    by_own = plain[np.ix_(rest, own)] @ pseudo_inverse(plain[np.ix_(own, own)], 1e-12)
    alone = plain[np.ix_(rest, rest)] - by_own @ plain[np.ix_(own, rest)]
    errors[:, len(order) :] = errors[:, rows] @ by_own.T + _drawn(alone, rng)
    instead = joint.motion_sets.errors()
    if instead is not None:
        drawn = rng.integers(DRAWS, size=DRAWS)
        real = np.flatnonzero(drawn < len(instead))
        places = [*rows, *range(len(order), errors.shape[1])]
        errors[np.ix_(real, places)] += instead[drawn[real]][:, [*own, *rest]]
    columns = [*map(Column.of, order), *(used[n] for n in rest)]
    _, taken, covariance = joint.system.source.of_each_view(columns, POSE)
    values, vectors = np.linalg.eigh(covariance * joint.variance * statistics.inflation)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    poses = np.einsum("vij,dvj->dvi", roots, rng.standard_normal((DRAWS, len(taken), len(POSE))))
    poses -= np.einsum("vin,dn->dvi", taken, errors)
    # The angle and the position that all views share count in each.
    terms = [column.term for column in columns]
    for number, term in enumerate(POSE):
        poses[:, :, number] += errors[:, terms.index(term), None]
    axes = beam_axes(joint.model)
    return ViewErrors(errors[:, : len(order)], np.einsum("vji,dvj->dvi", axes, poses), axes)


def _drawn(covariance: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw errors (`DRAWS`, n) with this covariance."""
    values, vectors = np.linalg.eigh(covariance)
    drawn: FloatArray = rng.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    return drawn
