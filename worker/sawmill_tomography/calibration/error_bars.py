"""The error bars of a calibration: the covariance, and the predicted ray error."""

from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.covariance import Covariance, frame_deviation, theta_covariance
from sawmill_tomography.calibration.joint_fit.residual_statistics import ResidualStatistics
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.ray_error import (
    RayAlternatives,
    RayErrorMixture,
    RayErrorPrediction,
    predicted_ray_error,
)


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Uncertainties of a calibration."""

    covariance: Covariance  # covariance of the geometry's five unknowns
    ray_covariance: FloatArray  # (5 + 2 modules, 5 + 2 modules)
    hidden_modules: tuple[RayAlternatives, ...]
    hidden_motions: RayErrorMixture | None  # motions that the scan may hide; None where it hides none
    theta_covariance: FloatArray | None  # (5, 5) or None: covariance of theta
    predicted_ray_error: RayErrorPrediction  # predicted ray error inside the log's disc
    inflation: float  # factor by which the residual's correlation within views inflated the covariance
    deviation_ratio: float
    source_shift_resolved: bool  # True if the source shift differs from zero by more than its uncertainty

    @property
    def theta_deviation(self) -> FloatArray | None:
        """Standard deviations of theta, (5,); None where theta has no covariance."""
        return None if self.theta_covariance is None else np.sqrt(np.diag(self.theta_covariance))

    def frame_deviation(self, frame: SourceFrame) -> FloatArray:
        """Compute standard deviations of (psi, R, SDD, u_c, tau, M), (6,); zero where held or unknown."""
        return frame_deviation(frame, self.covariance.values)


def error_bars(
    scanner: Scanner, frame: SourceFrame, theta: Theta, statistics: ResidualStatistics, radius_mm: float
) -> ErrorBars:
    """Compute the error bars from the residual's statistics, for rays inside a disc of this radius."""
    covariance = statistics.covariance.of_frame
    of_theta = theta_covariance(scanner, frame, theta, covariance.values)
    return ErrorBars(
        covariance=covariance,
        ray_covariance=statistics.ray_covariance,
        hidden_modules=statistics.hidden_modules,
        hidden_motions=statistics.hidden_motions,
        theta_covariance=of_theta,
        predicted_ray_error=predicted_ray_error(
            scanner,
            frame,
            statistics.ray_covariance,
            statistics.hidden_modules,
            statistics.hidden_motions,
            radius_mm=radius_mm,
        ),
        inflation=statistics.inflation,
        deviation_ratio=statistics.deviation_ratio,
        source_shift_resolved=of_theta is not None,
    )
