"""Drift from a sinogram in memory: what the job and the command line share."""

import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.calibrations import CalibrationResult
from sawmill_worker.contracts.drifts import DetectorDeviation, DetectorGeometry, DriftResult, TurnDisturbance
from sawmill_worker.tomography.calibration.scale import TWO_SIDED_95
from sawmill_worker.tomography.detector_fit import detector_fit
from sawmill_worker.tomography.drift import (
    DISTANCE_NOT_SEEN,
    FLAT_FIELD_NOT_SEEN,
    NOT_SEEN,
    ConjugateFit,
    DetectorFit,
    Disturbance,
    DriftChange,
    disturbed_turn,
    drift_change,
    likely_cause,
    seen_vector,
)
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.log_radius import refuse_log_beyond_source
from sawmill_worker.tomography.present_rows import rows_of_all
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.vocabulary.version import VERSION


@dataclass(frozen=True, eq=False)
class DriftInput:
    """A sinogram (views, detector) with each view's angle, and what it is compared with.

    Attributes
    ----------
    deviations : (views, detector) or None
        Standard deviations of the sinogram; None where they are not known.
    log_radius_mm : float or None
        Of the disc in which rays are counted; None takes the calibration's own.
    remarks : tuple of str
        What was left out on reading.
    """

    sinogram: FloatArray
    angles_rad: FloatArray
    rows: tuple[int, int]
    calibration: CalibrationResult
    input_sha256: str
    deviations: FloatArray | None = None
    log_radius_mm: float | None = None
    tolerance_mm: float = 0.5
    tolerance_scale_percent: float = 0.5
    remarks: tuple[str, ...] = ()


class CommonMean(NamedTuple):
    """The mean (views, detector) over the rows that every view has, and what was left out, in sentences.

    Its standard deviations (views, detector) are None where those of the rows are not known.
    """

    sinogram: FloatArray
    remarks: tuple[str, ...]
    deviations: FloatArray | None


def mean_of_common_rows(
    stack: NDArray[np.float32], first_row: int, row_step: int = 1, deviations: NDArray[np.float32] | None = None
) -> CommonMean:
    """Of a stack (views, rows, detector): views compare only where they cross the same part of the log.

    Refused where no row is in every view.

    Parameters
    ----------
    deviations : (views, rows, detector), optional
        Standard deviations of the stack.
    """
    common = rows_of_all(stack)
    if not common.any():
        last = first_row + (common.size - 1) * row_step
        raise refused("rows-missing", f"no row from {first_row} to {last} is in every view: give others with rows")
    left_out = first_row + row_step * np.flatnonzero(~common)
    remarks = (f"rows {', '.join(map(str, left_out))} were left out, which some views lack",) if left_out.size else ()
    # A view of the stack where all rows are there: nothing is copied.
    mean = (stack[:, common] if left_out.size else stack).mean(axis=1, dtype=np.float64)
    if deviations is None:
        return CommonMean(mean, remarks, None)
    return CommonMean(mean, remarks, np.linalg.norm(deviations[:, common].astype(np.float64), axis=1) / common.sum())


def run_drift(given: DriftInput) -> DriftResult:
    """Pair opposite rays or views and compare; errors of `sawmill_worker.tomography` pass through."""
    started = time.perf_counter()
    known = given.calibration
    scanner, calibrated = known.scanner, known.source_frame
    refuse_log_beyond_source(given.log_radius_mm, scanner)
    radius_mm = given.log_radius_mm or known.radius_mm
    fit = detector_fit(
        scanner, given.sinogram, given.angles_rad, calibrated, known.rotation, deviations=given.deviations
    )
    covariance = None if known.covariance is None else np.array(known.covariance)
    changed = drift_change(scanner, calibrated, covariance, fit, radius_mm=radius_mm)
    turned_over = fit.rotation is not known.rotation
    within = _within(changed, given, turned_over=turned_over)
    return DriftResult(
        measured=_detector(seen_vector(fit)),
        standard_deviation=_deviation(fit, fit.deviation),
        covariance=fit.covariance.tolist(),
        calibrated=_detector(seen_vector(calibrated)),
        change=_detector(changed.change),
        change_standard_deviation=_deviation(fit, changed.deviation),
        significance=_deviation(fit, changed.significance),
        moved=changed.moved,
        ray_change_mm=changed.ray_change_mm,
        ray_change_uncertainty_mm=changed.ray_change_uncertainty_mm,
        scale_change_percent=100.0 * changed.scale_change,
        scale_change_uncertainty_percent=100.0 * TWO_SIDED_95 * changed.scale_deviation,
        radius_mm=radius_mm,
        tolerance_mm=given.tolerance_mm,
        within_tolerance=within,
        reason=_reason(given, fit, changed, within=within, turned_over=turned_over),
        method="opposite-rays" if isinstance(fit, ConjugateFit) else "view-pairs",
        not_seen=_not_seen(fit),
        rotation=fit.rotation,
        rotation_ratio=fit.rotation_ratio,
        rotation_decided=fit.rotation_decided,
        relative_residual=fit.relative_residual,
        disturbances=[_disturbance(each, amplitude) for each, amplitude in fit.disturbances.items()],
        adjustments=[*given.remarks, *fit.adjustments],
        scanner=known.scanner,
        views=int(given.angles_rad.size),
        rows=given.rows,
        time_s=time.perf_counter() - started,
        software_version=VERSION,
        input_sha256=given.input_sha256,
    )


def _within(changed: DriftChange, given: DriftInput, *, turned_over: bool) -> bool | None:
    # A scale that this scan hardly sees is no reason for an alarm.
    allowed = max(given.tolerance_scale_percent / 100.0, TWO_SIDED_95 * changed.scale_deviation)
    if turned_over or abs(changed.scale_change) > allowed:
        return False
    if changed.ray_change_uncertainty_mm > given.tolerance_mm:
        return None
    return changed.ray_change_mm <= given.tolerance_mm


def _reason(
    given: DriftInput, fit: DetectorFit, changed: DriftChange, *, within: bool | None, turned_over: bool
) -> str:
    of_the_turn = disturbed_turn(fit)
    of_the_detector = _of_the_detector(given, changed, within=within, turned_over=turned_over)
    return of_the_detector if of_the_turn is None else f"{of_the_turn}; apart from that, {of_the_detector}"


def _of_the_detector(given: DriftInput, changed: DriftChange, *, within: bool | None, turned_over: bool) -> str:
    if turned_over:
        return "the log turned the other way than at the calibration: check the drive's direction and the angles' sign"
    if within is None:
        return (
            f"this scan places rays to {changed.ray_change_uncertainty_mm:.2g} mm and {given.tolerance_mm:.2g} mm is "
            "asked for: average more rows, or scan a log that is less round or less centred"
        )
    return likely_cause(given.calibration.source_frame, changed)


def _not_seen(fit: DetectorFit) -> list[str]:
    also = ((fit.distance_held, DISTANCE_NOT_SEEN), (not isinstance(fit, ConjugateFit), FLAT_FIELD_NOT_SEEN))
    return [*NOT_SEEN, *(sentence for holds, sentence in also if holds)]


def _disturbance(each: Disturbance, amplitude: float) -> TurnDisturbance:
    if each.part == "encoder":
        return TurnDisturbance(part=each.part, times_a_turn=each.order, amplitude_deg=amplitude)
    return TurnDisturbance(part=each.part, times_a_turn=each.order, amplitude_mm=amplitude)


def _detector(values: FloatArray) -> DetectorGeometry:
    column, tilt, distance = (float(value) for value in values)
    return DetectorGeometry(cor_column_mm=column, tilt_rad=tilt, source_to_detector_mm=distance)


def _deviation(fit: DetectorFit, values: FloatArray) -> DetectorDeviation:
    column, tilt, distance = (float(value) for value in values)
    return DetectorDeviation(
        cor_column_mm=column, tilt_rad=tilt, source_to_detector_mm=None if fit.distance_held else distance
    )
