"""The end point of the joint fit: the model, the fitted effects, and what may be real instead of them."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.covariance import Covariance
from sawmill_tomography.calibration.fit import Fit
from sawmill_tomography.calibration.joint_fit.groups import Fitted
from sawmill_tomography.calibration.joint_fit.modules import HiddenModule
from sawmill_tomography.calibration.joint_fit.motion_sets import MotionSets
from sawmill_tomography.calibration.joint_fit.normal_equations import Column, System
from sawmill_tomography.calibration.joint_fit.scan_model import ScanModel, Term
from sawmill_tomography.calibration.joint_fit.selection import EffectTest
from sawmill_tomography.calibration.joint_fit.view_poses import PoseSizes
from sawmill_tomography.calibration.joint_fit.wood_patches import Variation
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray, wrap_angle
from sawmill_vocabulary import DetectorModule, Scanner, TrueAxis


@dataclass(frozen=True, eq=False)
class JointFit:
    """The end point of the joint fit."""

    model: ScanModel
    fitted: tuple[Fitted, ...]  # effects in the fit
    system: System  # normal equations of all columns at the end
    used: list[int]
    precision: FloatArray  # (used,): what the priors add to the diagonal of the normal equations
    change: FloatArray
    variance: float
    declined: tuple[tuple[Fitted, EffectTest], ...]  # effects that the scan shows, and that must not be fitted
    motion_sets: MotionSets
    angle_variance: float  # variance of the views' angles, rad^2; 0 where the angles do not scatter
    variation: Variation | None  # how much the wood's density varies from patch to patch
    hidden_modules: tuple[tuple[HiddenModule, ...], ...]
    poses: PoseSizes | None  # sizes of the poses of single views; None where the object turns in one scan
    converged: bool
    rounds: int

    @property
    def biases(self) -> list[FloatArray]:
        """Errors of the fitted columns, the geometry's first, for each effect that is real and must not be fitted."""
        return [test.bias for _, test in self.declined]

    @property
    def modules(self) -> tuple[DetectorModule, ...]:
        """The detector's modules after the first: the known ones and the ones that the scan shows."""
        return self.model.data.cells.modules

    def seen_by(self, scanner: Scanner) -> Scanner:
        """Return the scanner with the places of the detector's cells that the scan shows."""
        cells = self.model.data.cells
        return replace(
            scanner,
            detector_modules=cells.modules,
            detector_arc_radius_mm=cells.arc_radius_mm,
            detector_waves_mm=cells.waves_mm,
        )

    @property
    def aspect(self) -> float:
        """Share by which the phantom is longer in x than in y."""
        return self.model.size(Term.ASPECT)

    def without(self, one: Fitted) -> tuple[list[Column], FloatArray]:
        """Return the fitted columns without an effect's, and their errors if the effect were not fitted."""
        columns = self.system.columns
        rest = [i for i in self.used if i not in one.places]
        off = self.system.inverse(rest) @ self.system.normal[np.ix_(rest, one.places)] @ one.sizes
        return [columns[i] for i in rest], off


def as_fit(joint: JointFit, covariance: Covariance, true_axis: TrueAxis | None, source_to_cor_mm: float) -> Fit:
    """Return the fit to report; millimetres are measured by the drawing's true axis, or by the mean of both axes.

    Where the true axis would put the source nearer than r_S, the source stays at r_S.
    """
    model, data = joint.model, joint.model.data
    rms = math.sqrt(float(np.average(model.residual**2, weights=data.weights)))
    centred = data.sinogram - float(np.average(data.sinogram, weights=data.weights))
    total = math.sqrt(float(np.average(centred**2, weights=data.weights)))
    half = 0.5 * model.size(Term.ASPECT)
    longer = {"x": 1.0 + half, "y": 1.0 - half, None: 1.0}[true_axis]
    distance = model.frame.source_distance_mm
    scale = max(1.0 / longer, min(source_to_cor_mm / distance, 1.0))
    return Fit(
        frame=replace(model.frame, psi_rad=wrap_angle(model.frame.psi_rad), source_distance_mm=scale * distance),
        position_mm=(scale * float(model.x[FitParameter.T_X]), scale * float(model.x[FitParameter.T_Y])),
        gain=float(model.gain.mean()) / scale,
        offset=float(model.offset.mean()),
        residual_rms=rms,
        relative_residual=rms / total if total > 0.0 else math.inf,
        covariance=covariance,
        converged=joint.converged or _within(joint, covariance),
        iterations=joint.rounds,
    )


def _within(joint: JointFit, covariance: Covariance) -> bool:
    """Return whether the last step moved every parameter of the geometry by at most one standard deviation."""
    deviations = np.sqrt(np.diag(covariance.values))
    changes = zip(joint.system.columns, joint.change.tolist(), strict=True)
    return all(abs(size) <= deviations[column.parameter] for column, size in changes if column.parameter is not None)
