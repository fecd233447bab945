"""A calibration from a sinogram in memory: what the job and the command line share."""

import math
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts import calibrations as contracts
from sawmill_worker.contracts.geometry import ScannerConstants, ThetaBounds
from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.tomography.calibration.calibrate import calibrate
from sawmill_worker.tomography.calibration.calibration import Calibration
from sawmill_worker.tomography.calibration.errors import CalibrationError
from sawmill_worker.tomography.calibration.phantom_rows import segments
from sawmill_worker.tomography.calibration.task import CalibrationTask
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.use_cases.conversion import (
    from_deviation,
    from_frame,
    from_predicted,
    from_theta,
    to_bounds,
    to_phantom,
    to_scanner,
)
from sawmill_worker.vocabulary import CalibrationMethod, Handedness, Progress, ProgressCallback, Rotation

# Runs of rows that are tried, longest first: a phantom covers more rows than a saw's kerf.
MOST_RUNS = 8


@dataclass(frozen=True)
class CalibrationInput:
    """What is calibrated: a sinogram (views, detector) with each view's angle, and what is known of it."""

    sinogram: FloatArray
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    bounds: ThetaBounds | None
    drawing: PhantomDrawing
    input_sha256: str
    log_radius_mm: float = 150.0
    tolerance_mm: float = 0.1
    from_counts: bool = False
    remarks: tuple[str, ...] = ()


def with_phantom_rows(
    given: CalibrationInput, stack: NDArray[np.float32], options: contracts.CalibrationOptions
) -> CalibrationInput:
    """The input narrowed to those rows of the stack (views, rows, detector) that show the phantom.

    Where nothing changes from row to row, or no run of rows explains itself by the phantom, all rows stay.
    """
    runs = segments(stack)
    found: list[tuple[float, CalibrationInput]] = []
    for run in runs[:MOST_RUNS] if len(runs) > 1 else []:
        rows = (given.rows[0] + run.start, given.rows[0] + run.stop)
        narrowed = replace(given, sinogram=stack[:, run].mean(axis=1, dtype=np.float64), rows=rows)
        try:
            fit = calibrate(_task(narrowed, options))
        except CalibrationError:  # these rows show something else
            continue
        found.append((fit.relative_residual, narrowed))
    if not found:
        return given
    _, best = min(found, key=lambda item: item[0])
    told = f"of rows {given.rows[0]}:{given.rows[1]}, {best.rows[0]}:{best.rows[1]} show the phantom and were used"
    return replace(best, remarks=(told,))


def _task(given: CalibrationInput, chosen: contracts.CalibrationOptions) -> CalibrationTask:
    return CalibrationTask(
        scanner=to_scanner(given.scanner),
        phantom=to_phantom(given.drawing),
        sinogram=given.sinogram,
        angles_rad=given.angles_rad,
        bounds=to_bounds(given.bounds),
        handedness=chosen.handedness,
        rotation=chosen.rotation,
        rays_per_cell=chosen.rays_per_cell,
        log_radius_mm=given.log_radius_mm,
        tolerance_mm=given.tolerance_mm,
        from_counts=given.from_counts,
        without=frozenset(chosen.without),
    )


def run_calibration(
    given: CalibrationInput, options: contracts.CalibrationOptions, report: ProgressCallback
) -> tuple[Calibration, contracts.CalibrationResult]:
    """Calibrate by the method asked for; errors of `sawmill_worker.tomography` pass through."""
    task = _task(given, options)

    def progress(generation: int, most: int, best: float) -> None:
        fraction = min(generation / most, 0.95)
        # Nothing fits yet: there is no best value to tell.
        value = best if math.isfinite(best) else None
        report(Progress(fraction=fraction, stage="search", generation=generation, best_value=value))

    if options.method is CalibrationMethod.PAPER:
        # Imported here because it brings the reconstruction along, for which the default need not wait.
        from sawmill_worker.tomography.calibration.paper import PaperOptions, calibrate_as_published  # noqa: PLC0415

        paper = PaperOptions(**options.paper.model_dump())
        calibration = calibrate_as_published(task, options=paper, seed=options.seed, progress=progress)
    else:
        calibration = calibrate(task, seed=options.seed, progress=progress)
    return calibration, calibration_result(calibration, given)


def calibration_result(calibration: Calibration, given: CalibrationInput) -> contracts.CalibrationResult:
    """The answer as it crosses a boundary."""
    predicted, deviation = calibration.predicted_ray_error, calibration.frame_deviation
    return contracts.CalibrationResult(
        theta=from_theta(calibration.theta),
        theta_twin=None if calibration.theta_twin is None else from_theta(calibration.theta_twin),
        source_frame=from_frame(calibration.frame),
        standard_deviation=None if deviation is None else from_deviation(calibration.theta_deviation, deviation),
        covariance=None if calibration.covariance is None else calibration.covariance.tolist(),
        theta_covariance=None if calibration.theta_covariance is None else calibration.theta_covariance.tolist(),
        unconstrained_source_distance_mm=calibration.unconstrained_source_distance_mm,
        scale_uncertainty_mm=calibration.scale_uncertainty_mm,
        scale_ray_error_mm=calibration.scale_ray_error_mm,
        predicted_ray_error_mm=None if predicted is None else from_predicted(predicted, calibration.log_radius_mm),
        handedness=Handedness(calibration.handedness),
        rotation=Rotation(calibration.rotation),
        hypotheses=_hypotheses(calibration),
        phantom_position_mm=calibration.position_mm,
        gain=calibration.gain,
        offset=calibration.offset,
        residual=contracts.Residual(rms=calibration.residual_rms, relative=calibration.relative_residual),
        adjustments=[*given.remarks, *calibration.adjustments],
        status=calibration.status,
        verdict=calibration.verdict,
        reasons=list(calibration.reasons),
        scanner=given.scanner,
        phantom=given.drawing.name,
        views=int(given.angles_rad.size),
        rows=given.rows,
        search=contracts.Search(**{name: getattr(calibration.search, name) for name in contracts.Search.model_fields}),
        timing_s=contracts.Timing(**calibration.seconds),
        software_version=version("sawmill-calibration"),
        input_sha256=given.input_sha256,
    )


def _hypotheses(calibration: Calibration) -> list[contracts.Hypothesis]:
    """All that were tried, with how far each is behind the best in log-likelihood."""
    best = calibration.hypotheses[0].relative_residual
    independent = None if calibration.covariance is None else calibration.residual.size / calibration.inflation
    return [
        contracts.Hypothesis(
            **vars(report),
            log_likelihood_behind=None
            if independent is None or best <= 0.0
            else independent * math.log(report.relative_residual / best),
        )
        for report in calibration.hypotheses
    ]
