"""The source distance R, which no theta allows to be less than the known r_S: held there where the free fit is less."""

import math
from dataclasses import dataclass, replace

from sawmill_worker.tomography.calibration.errors import CalibrationError
from sawmill_worker.tomography.calibration.faults.finding import AdjustedFit
from sawmill_worker.tomography.calibration.fit import refine
from sawmill_worker.tomography.calibration.task import CalibrationTask
from sawmill_worker.tomography.fit_parameters import Parameter


@dataclass(frozen=True)
class SourceDistance:
    """How R was found.

    Attributes
    ----------
    unconstrained_mm : float
        R of the free fit.
    held : bool
        R was held at r_S, because the free fit gave less.
    deficit_deviations : float
        By how many standard deviations, the stated size's included, the free R is less than r_S; 0 where it is not.
    """

    unconstrained_mm: float
    held: bool = False
    deficit_deviations: float = 0.0


def with_theta(task: CalibrationTask, free: AdjustedFit) -> tuple[AdjustedFit, SourceDistance]:
    """The free fit, or the one with R = r_S where the free one has no theta (docs/conventions.md#theta).

    Raises
    ------
    CalibrationError
        If no fit exists with R = r_S.
    """
    r_s, frame = task.scanner.source_to_cor_mm, free.fit.frame
    if frame.source_distance_mm >= r_s:
        return free, SourceDistance(frame.source_distance_mm)
    ratio = r_s / frame.source_distance_mm
    start = replace(frame, source_distance_mm=r_s, source_to_detector_mm=frame.source_to_detector_mm * ratio)
    fit = refine(free.phantom, free.data, start, position_mm=free.fit.position_mm, fixed_source_distance=True)
    if fit is None:
        raise CalibrationError(
            "no-geometry",
            f"the scan asks for a source at {frame.source_distance_mm:.4g} mm, nearer than source_to_cor_mm "
            f"{r_s:.6g}: check source_to_cor_mm and the phantom's size",
        )
    return replace(free, fit=fit), SourceDistance(
        frame.source_distance_mm, held=True, deficit_deviations=_deficit_deviations(task, free)
    )


def _deficit_deviations(task: CalibrationTask, free: AdjustedFit) -> float:
    distance = free.fit.frame.source_distance_mm
    variance = float(free.scatter.covariance.values[Parameter.R, Parameter.R])
    deviation = math.hypot(math.sqrt(variance), task.phantom.size_tolerance * distance)
    deficit = task.scanner.source_to_cor_mm - distance
    return deficit / deviation if deviation > 0.0 else math.inf
