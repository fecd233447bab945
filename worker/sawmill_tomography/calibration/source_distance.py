"""The source distance R: held at the known r_S where the free fit gives less, since theta exists only for R >= r_S."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sawmill_tomography.calibration.fit import OnStep, ignore_progress, refine
from sawmill_tomography.calibration.joint_fit.finding import AdjustedFit
from sawmill_tomography.calibration.joint_fit.fitter import fit_consistent_views, fit_jointly
from sawmill_tomography.calibration.joint_fit.joint_fit import JointFit
from sawmill_tomography.calibration.joint_fit.residual_statistics import ResidualStatistics, residual_statistics
from sawmill_tomography.calibration.refusals import CalibrationError, refuse_other_scanner
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import SourceFrame


@dataclass(frozen=True)
class SourceDistance:
    """The source distance of the free fit, and whether R was held."""

    unconstrained_mm: float  # R of the free fit
    held: bool = False  # R was held at r_S, because the free fit gave less
    deficit_deviations: float = 0.0


def with_theta(
    task: CalibrationTask, prepared: AdjustedFit, on_step: OnStep = ignore_progress
) -> tuple[AdjustedFit, JointFit, ResidualStatistics, SourceDistance]:
    """Fit freely, or with R = r_S where the free fit has no theta (docs/look-up/conventions.md#theta).

    The covariance of a held fit is the free fit's covariance plus the square of the change that holding made: the
    scanner's R may be larger than r_S, or r_S itself be wrong, and R and SDD then have errors together. The scan
    determines the ratio of R and SDD far better than either distance, so R's row stays in the covariance.
    """
    prepared, free = fit_consistent_views(prepared, task.without, on_step)
    r_s, frame = task.scanner.source_to_cor_mm, free.model.frame
    refuse_other_scanner(task.scanner, frame.source_distance_mm)
    statistics = residual_statistics(free)
    if frame.source_distance_mm >= r_s:
        return prepared, free, statistics, SourceDistance(frame.source_distance_mm)
    ratio = r_s / frame.source_distance_mm
    start = replace(frame, source_distance_mm=r_s, source_to_detector_mm=frame.source_to_detector_mm * ratio)
    position = (float(free.model.x[FitParameter.T_X]), float(free.model.x[FitParameter.T_Y]))
    fit = refine(
        prepared.phantom, prepared.data, start, position_mm=position, fixed_source_distance=True, on_step=on_step
    )
    if fit is None:
        raise CalibrationError(
            "no-geometry",
            f"the scan asks for a source at {frame.source_distance_mm:.4g} mm, nearer than source_to_cor_mm "
            f"{r_s:.6g}: check source_to_cor_mm and the phantom's size",
        )
    held = fit_jointly(replace(prepared, fit=fit), task.without, on_step).result()
    distance = SourceDistance(
        frame.source_distance_mm, held=True, deficit_deviations=_deficit_deviations(task, frame, statistics)
    )
    moved = held.model.x - free.model.x
    by_holding = np.outer(moved, moved)
    of_free, statistics = statistics, residual_statistics(held)
    # Errors of other places of cells than those of the free fit are those next to a known R.
    base = of_free if of_free.ray_covariance.shape == statistics.ray_covariance.shape else statistics
    of_rays = np.zeros_like(base.ray_covariance)
    of_rays[FRAME, FRAME] = by_holding[FRAME, FRAME]
    covariance = replace(base.covariance, values=base.covariance.values + by_holding)
    parts, of_rays = base.parts | {"held-source-distance": of_rays}, base.ray_covariance + of_rays
    return prepared, held, replace(statistics, covariance=covariance, ray_covariance=of_rays, parts=parts), distance


def _deficit_deviations(task: CalibrationTask, frame: SourceFrame, statistics: ResidualStatistics) -> float:
    distance = frame.source_distance_mm
    variance = float(statistics.covariance.values[FitParameter.R, FitParameter.R])
    deviation = math.hypot(math.sqrt(variance), task.phantom.size_tolerance * distance)
    return (task.scanner.source_to_cor_mm - distance) / deviation if deviation > 0.0 else math.inf
