"""What a calibration answers, whichever search found the basin."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_worker.tomography.calibration.search import SearchReport
from sawmill_worker.tomography.geometry import FloatArray, Scanner, SourceFrame, Theta, ThetaBounds
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.ray_error import PredictedRayError
from sawmill_worker.vocabulary import CalibrationStatus, Handedness, Rotation


@dataclass(frozen=True)
class HypothesisReport:
    """One of the four hypotheses and how much of the sinogram it leaves unexplained."""

    handedness: Handedness
    rotation: Rotation
    relative_residual: float


@dataclass(frozen=True)
class Calibration:
    """The complete answer.

    Attributes
    ----------
    phantom : Phantom
        As drawn. `seen` is the phantom as the scan shows it: mirrored if seen from behind, and where it stood.
    covariance : (5, 5) float64 or None
        Of (psi, R, SDD, u_c, tau); the row of a fixed parameter is zero. None from a search that has no error bars.
    theta_covariance : (5, 5) float64 or None
        Of theta; None where the source shift, or the first angle, is not resolved.
    source_distance_fixed : bool
        R was held at r_S, because the free fit gave less: `unconstrained_source_distance_mm`.
    adjustments : tuple of str
        What was found in the scan beyond the plain model, and what was done about it.
    scale_uncertainty_mm, scale_ray_error_mm : float
        What R, and the rays (RMS), inherit from the phantom's size tolerance: systematic, and unseen by any residual.
    inflation : float
        Factor by which the residual's correlation within views widened the covariance; 1 for white noise.
    """

    scanner: Scanner
    phantom: Phantom
    frame: SourceFrame
    theta: Theta
    theta_twin: Theta | None
    covariance: FloatArray | None
    theta_covariance: FloatArray | None
    source_distance_fixed: bool
    unconstrained_source_distance_mm: float
    scale_uncertainty_mm: float
    scale_ray_error_mm: float
    predicted_ray_error: PredictedRayError | None
    log_radius_mm: float
    inflation: float
    handedness: Handedness
    rotation: Rotation
    hypotheses: tuple[HypothesisReport, ...]
    position_mm: tuple[float, float]
    gain: float
    offset: float
    residual_rms: float
    relative_residual: float
    model: FloatArray
    residual: FloatArray
    adjustments: tuple[str, ...]
    status: CalibrationStatus
    verdict: str
    reasons: tuple[str, ...]
    search: SearchReport
    seconds: dict[str, float]

    @property
    def seen(self) -> Phantom:
        """The phantom as the scan shows it, in the image frame of theta."""
        drawn = self.phantom if self.handedness is Handedness.AS_DRAWN else self.phantom.mirrored()
        return drawn.moved(*self.position_mm)

    @property
    def theta_deviation(self) -> FloatArray | None:
        """Standard deviations of theta, (5,); None where it has no covariance."""
        return None if self.theta_covariance is None else np.sqrt(np.diag(self.theta_covariance))

    @property
    def frame_deviation(self) -> FloatArray | None:
        """Standard deviations of (psi, R, SDD, u_c, tau, M), (6,); zero where fixed; None without error bars."""
        if self.covariance is None:
            return None
        return frame_deviation(self.frame, self.covariance)


def choose_theta(scanner: Scanner, frame: SourceFrame, bounds: ThetaBounds | None) -> tuple[Theta, Theta | None]:
    """The theta to report and its twin: the one inside the bounds, else the one with h_S >= 0."""
    theta = frame.theta(scanner.source_to_cor_mm)
    if theta.source_shift_mm == 0.0:
        return theta, None
    twin = theta.twin(scanner.source_to_cor_mm)
    if bounds is not None and bounds.contain(twin) and not bounds.contain(theta):
        return twin, theta
    return theta, twin


def frame_deviation(frame: SourceFrame, covariance: FloatArray) -> FloatArray:
    """Standard deviations of (psi, R, SDD, u_c, tau, M), (6,)."""
    r, sdd = frame.source_distance_mm, frame.source_to_detector_mm
    slope = np.array([0.0, -sdd / (r * r), 1.0 / r, 0.0, 0.0])
    magnification = math.sqrt(max(float(slope @ covariance @ slope), 0.0))
    return np.append(np.sqrt(np.diag(covariance)), magnification)


def theta_covariance(scanner: Scanner, frame: SourceFrame, theta: Theta, covariance: FloatArray) -> FloatArray | None:
    """The covariance of theta to first order, (5, 5); None where h_S is not resolved from zero."""
    r, r_s = frame.source_distance_mm, scanner.source_to_cor_mm
    spread = math.sqrt(float(covariance[1, 1]))
    if spread == 0.0 or r - r_s <= 2.0 * spread:
        return None
    sign = 1 if theta.source_shift_mm >= 0.0 else -1
    vector = frame.to_vector()
    # A step in R must stay well above r_S, where h_S has a square-root branch point.
    steps = np.array([1e-6, min(1e-4, 1e-3 * (r - r_s)), 1e-3, 1e-3, 1e-6])
    columns = []
    for index, step in enumerate(steps):
        ends = []
        for direction in (1.0, -1.0):
            moved = vector.copy()
            moved[index] += direction * step
            ends.append(SourceFrame.from_vector(moved).theta(r_s, source_shift_sign=sign).to_vector())
        change = ends[0] - ends[1]
        change[0] = math.remainder(change[0], 2.0 * math.pi)
        columns.append(change / (2.0 * step))
    slope = np.stack(columns, -1)
    carried: FloatArray = slope @ covariance @ slope.T
    return carried
