"""Plan of a calibration from a phantom's drawing and a nominal geometry."""

import numpy as np

from sawmill_calibration.known_geometry import from_deviation, from_predicted, to_phantom
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanOptions, PlanResult
from sawmill_tomography.calibration.planning import plan
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_vocabulary import Theta
from sawmill_vocabulary.version import VERSION


def run_plan(
    drawing: PhantomDrawing,
    scanner: ScannerConstants,
    theta: Theta,
    options: PlanOptions,
    log_radius_mm: float | None = None,
) -> PlanResult:
    """Predict the precision of a calibration of a scanner of this nominal theta.

    Parameters
    ----------
    log_radius_mm : float, optional
        Radius of the disc in which ray errors are counted, mm; the phantom's by default, at most 150.

    Raises
    ------
    ValueError
        The phantom determines nothing there: errors of `sawmill_tomography`.
    """
    fan = FanBeamGeometry(scanner, theta, (np.arange(options.views) + 0.5) * 2.0 * np.pi / options.views)
    phantom = to_phantom(drawing, options.size_tolerance_percent)
    planned = plan(fan, phantom, noise=options.noise, log_radius_mm=log_radius_mm)
    return PlanResult(
        theta=theta,
        source_frame=fan.frame,
        standard_deviation=from_deviation(planned.theta_deviation, planned.frame_deviation),
        covariance=planned.covariance.tolist(),
        predicted_ray_error_mm=from_predicted(
            planned.predicted_ray_error, scanner, fan.frame, planned.covariance, planned.radius_mm
        ),
        scale_uncertainty_mm=planned.scale.source_distance_mm,
        scale_ray_error_mm=planned.scale.ray_error_mm,
        scale_uncertainty_percent=planned.scale.percent_95,
        noise_mm=planned.noise,
        views_cut_off=planned.views_cut_off,
        phantom=drawing.name,
        scanner=scanner,
        views=options.views,
        noise=options.noise,
        software_version=VERSION,
    )
