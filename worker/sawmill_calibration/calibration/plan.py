"""Plan of a calibration from a phantom's drawing and a nominal geometry, shared by the job and the command line."""

from dataclasses import dataclass

import numpy as np

from sawmill_calibration.conversion import from_deviation, from_predicted, to_phantom
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanOptions, PlanResult
from sawmill_tomography.calibration.planning import plan
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_vocabulary import Theta
from sawmill_vocabulary.version import VERSION


@dataclass(frozen=True)
class PlanInput:
    """Input of a plan."""

    drawing: PhantomDrawing
    scanner: ScannerConstants
    theta: Theta
    log_radius_mm: float | None = None


def run_plan(plan_input: PlanInput, options: PlanOptions) -> PlanResult:
    """Plan a calibration; errors of `sawmill_tomography` propagate."""
    angles_rad = (np.arange(options.views) + 0.5) * 2.0 * np.pi / options.views
    fan = FanBeamGeometry(plan_input.scanner, plan_input.theta, angles_rad)
    phantom = to_phantom(plan_input.drawing, options.size_tolerance_percent)
    planned = plan(fan, phantom, noise=options.noise, log_radius_mm=plan_input.log_radius_mm)
    return PlanResult(
        theta=plan_input.theta,
        source_frame=fan.frame,
        standard_deviation=from_deviation(planned.theta_deviation, planned.frame_deviation),
        covariance=planned.covariance.tolist(),
        predicted_ray_error_mm=from_predicted(planned.predicted_ray_error, planned.radius_mm),
        scale_uncertainty_mm=planned.scale.source_distance_mm,
        scale_ray_error_mm=planned.scale.ray_error_mm,
        scale_uncertainty_percent=planned.scale.percent_95,
        noise_mm=planned.noise,
        views_cut_off=planned.views_cut_off,
        phantom=plan_input.drawing.name,
        scanner=plan_input.scanner,
        views=options.views,
        noise=options.noise,
        software_version=VERSION,
    )
