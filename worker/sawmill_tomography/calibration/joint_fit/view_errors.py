"""Draws of the errors of a geometry and of the poses of the views it was fitted with, which compensate each other."""

import numpy as np

from sawmill_tomography.calibration.covariance import scaled_inverse
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.residual_statistics import ResidualStatistics, terms_of_rays
from sawmill_tomography.calibration.joint_fit.scan_model import POSE
from sawmill_tomography.calibration.joint_fit.view_poses import beam_axes
from sawmill_tomography.geometry.fit_parameters import FRAME
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import DRAWS, ViewErrors


def view_errors(joint: JointFit, statistics: ResidualStatistics) -> ViewErrors | None:
    """Draw the errors of the geometry and of the views' poses; None where the object turns in one scan."""
    if joint.poses is None:
        return None
    rng, order = np.random.default_rng(0), terms_of_rays(joint)
    used = [joint.system.columns[place] for place in joint.used]
    own = [n for n, column in enumerate(used) if column.term in order]
    rows = [order.index(column.term) for column in used if column.term in order]
    rest = [n for n in range(len(used)) if n not in own]
    errors = _drawn(statistics.ray_covariance, rng)
    # Other columns' errors follow from these, but for their own part.
    plain = joint.system.inverse(joint.used) * joint.variance
    by_own = plain[np.ix_(rest, own)] @ scaled_inverse(plain[np.ix_(own, own)])
    alone = _drawn(plain[np.ix_(rest, rest)] - by_own @ plain[np.ix_(own, rest)], rng)
    errors = np.concatenate([errors, errors[:, rows] @ by_own.T + alone], axis=1)
    instead = joint.motion_sets.errors
    if instead is not None:
        drawn = rng.integers(DRAWS, size=len(errors))
        real, places = np.flatnonzero(drawn < len(instead)), np.array([*rows, *range(len(order), errors.shape[1])])
        errors[np.ix_(real, places)] += instead[drawn[real]][:, [*own, *rest]]
    # Places of cells that the scan does not show have no error.
    shown = [n for n in range(len(order)) if n < FRAME.stop or n in rows]
    columns = [*(Column(((order[n], None),)) for n in shown), *(used[n] for n in rest)]
    of_columns = errors[:, [*shown, *range(len(order), errors.shape[1])]]
    if (patches := joint.system.patches) is not None:
        # Densities of the wood's patches follow from the columns too, but for their own part.
        columns += patches.whole.columns[len(joint.system.columns) :]
        by_columns = np.zeros((len(patches.change), of_columns.shape[1]))
        of_used = [*map(shown.index, rows), *range(len(shown), of_columns.shape[1])]
        by_columns[:, of_used] = patches.taken[:, [joint.used[n] for n in (*own, *rest)]]
        densities = _drawn(patches.inverse * joint.variance * statistics.inflation, rng)
        of_columns = np.concatenate([of_columns, densities - of_columns @ by_columns.T], axis=1)
    terms = [column.term for column in columns]
    _, taken, covariance = joint.system.source.of_each_view(columns, POSE)
    # The angle and the position that all views share count in each.
    taken -= np.array([[float(each == term) for each in terms] for term in POSE])
    values, vectors = np.linalg.eigh(covariance * joint.variance * statistics.inflation)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    poses = np.einsum("vij,dvj->dvi", roots, rng.standard_normal((len(errors), *values.shape)))
    poses -= np.einsum("vin,dn->dvi", taken, of_columns)
    axes = beam_axes(joint.model)
    return ViewErrors(errors[:, : len(order)], np.einsum("vji,dvj->dvi", axes, poses), axes)


def _drawn(covariance: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw errors (half of `DRAWS`, n) with this covariance: each draw has errors of all views."""
    values, vectors = np.linalg.eigh(covariance)
    drawn = rng.standard_normal((DRAWS // 2, len(values)))
    drawn /= np.sqrt((drawn**2).mean(axis=0))
    return np.asarray(drawn @ (vectors * np.sqrt(np.maximum(values, 0.0))).T)
