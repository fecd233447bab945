"""A plan from a phantom's drawing and a nominal geometry: what the job and the command line share."""

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from worker.contracts.calibrations import PredictedRayError, StandardDeviation
from worker.contracts.geometry import ScannerConstants, SourceFrameDeviation, Theta, ThetaDeviation
from worker.contracts.phantoms import PhantomDrawing
from worker.contracts.plans import PlanOptions, PlanResult
from worker.tasks.conversion import from_frame, to_phantom, to_scanner, to_theta
from worker.tomography.geometry import FanBeamGeometry
from worker.tomography.planning import Plan, plan


@dataclass(frozen=True)
class PlanInput:
    """What is planned with."""

    drawing: PhantomDrawing
    scanner: ScannerConstants
    theta: Theta
    log_radius_mm: float = 150.0


def run_plan(given: PlanInput, options: PlanOptions) -> PlanResult:
    """Plan; errors of `worker.tomography` pass through."""
    angles_rad = (np.arange(options.views) + 0.5) * 2.0 * np.pi / options.views
    fan = FanBeamGeometry(to_scanner(given.scanner), to_theta(given.theta), angles_rad)
    planned = plan(fan, to_phantom(given.drawing), noise=options.noise, log_radius_mm=given.log_radius_mm)
    predicted = planned.predicted_ray_error
    return PlanResult(
        theta=given.theta,
        source_frame=from_frame(fan.frame),
        standard_deviation=_deviation(planned),
        covariance=planned.covariance.tolist(),
        predicted_ray_error_mm=PredictedRayError(
            rms=predicted.rms_mm,
            max=predicted.max_mm,
            upper_95=predicted.upper_95_mm,
            radius_mm=given.log_radius_mm,
        ),
        scale_uncertainty_mm=planned.scale_uncertainty_mm,
        scale_ray_error_mm=planned.scale_ray_error_mm,
        noise_mm=planned.noise,
        views_cut_off=planned.views_cut_off,
        phantom=given.drawing.name,
        scanner=given.scanner,
        views=options.views,
        noise=options.noise,
        software_version=version("sawmill-calibration"),
    )


def _deviation(planned: Plan) -> StandardDeviation:
    theta = [None] * 5 if planned.theta_deviation is None else planned.theta_deviation.tolist()
    return StandardDeviation(
        theta=ThetaDeviation.model_validate(dict(zip(ThetaDeviation.model_fields, theta, strict=True))),
        source_frame=SourceFrameDeviation.model_validate(
            dict(zip(SourceFrameDeviation.model_fields, planned.frame_deviation.tolist(), strict=True))
        ),
    )
