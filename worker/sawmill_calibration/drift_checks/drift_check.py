"""Drift check with a scan, against a calibration or from a geometry measured by hand."""

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.failures import refused
from sawmill_calibration.known_geometry import GivenGeometry, KnownGeometry
from sawmill_calibration.scans.prepare import of_masked_rays
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_calibration.view_vectors import AnyGeometry, ImportedGeometry
from sawmill_contracts import drifts
from sawmill_contracts.choices import DriftMethod
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import Tolerances
from sawmill_tomography.calibration.sinogram_data import refuse_log_beyond_source
from sawmill_tomography.drift import change
from sawmill_tomography.drift.detector_fit import detector_fit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, cell_centres_mm
from sawmill_tomography.sinograms.present_rows import present_rows
from sawmill_tomography.statistics import TWO_SIDED_95
from sawmill_vocabulary import Progress, Rotation
from sawmill_vocabulary.messages import Reason, Value
from sawmill_vocabulary.movement_messages import LogMessage
from sawmill_vocabulary.version import VERSION

# Codes of refusals that interpolated rays may cause.
MASKED_CAUSES = ("nothing-seen", "moved-too-far")


@dataclass(frozen=True, eq=False)
class CommonMean:
    """Mean (views, detector) of the rows that every view has, and standard deviations, 0 for rays without one."""

    sinogram: FloatArray
    deviations: FloatArray | None = None
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Reference:
    """The geometry to compare with, and what it may move."""

    calibration: KnownGeometry
    tolerance_mm: float
    tolerance_scale_percent: float


def check_drift(
    scan: ScanRows,
    calibration: AnyGeometry,
    *,
    log_radius_mm: float | None = None,
    tolerance_mm: float = 0.5,
    tolerance_scale_percent: float = 0.5,
    baselines: tuple[drifts.KnownBaseline, ...] = (),
) -> drifts.DriftResult:
    """Compare a scan of a log with a calibration, or find the COR from a given geometry.

    Parameters
    ----------
    log_radius_mm : float, optional
        Radius of the disc in which rays are counted, mm; the calibration's by default.
    tolerance_mm, tolerance_scale_percent : float
        RMS ray distance, and change of the image's scale, up to which the scanner counts as not moved.
    baselines : tuple of KnownBaseline
        Baselines of the changes by method; the baseline of this scan's method is used.

    Raises
    ------
    ValueError
        The scan's views cannot be compared, or do not turn: `DriftError`, `InputError`, `GeometryError`.
    """
    if isinstance(calibration, ImportedGeometry):
        scan, calibration = calibration.turned(scan)
    if scan.averaged_rows is not None and scan.rows_named:
        raise refused(
            "rows-outside",
            "rows {}:{} were asked for, but the scan is the mean of {} rows, which are not kept: leave rows out".format(
                *scan.rows, scan.averaged_rows
            ),
        )
    mean = mean_of_common_rows(scan.stack(), scan.rows[0], scan.row_step, scan.deviations)
    scan.on_progress(Progress(fraction=0.5, stage="pair rays"))
    started = time.perf_counter()
    reference = _Reference(calibration, tolerance_mm, tolerance_scale_percent)
    nominal = calibration if isinstance(calibration, GivenGeometry) else None
    scanner, calibrated, angles_rad = calibration.scanner, calibration.source_frame, scan.angles_rad
    refuse_log_beyond_source(log_radius_mm, scanner)
    radius_mm = log_radius_mm or calibration.radius_mm
    start = calibrated if nominal is None else with_coarse_column(scanner, calibrated, mean.sinogram, angles_rad)
    try:
        fit = detector_fit(scanner, mean.sinogram, angles_rad, start, calibration.rotation, deviations=mean.deviations)
    except change.DriftError as error:
        masked = of_masked_rays(scan.remarks)
        if masked is None or error.code not in MASKED_CAUSES:
            raise
        raise change.DriftError(error.code, f"{error}. {masked} Wide masks do that too: send narrower ones") from error
    covariance = None if calibration.covariance is None else np.array(calibration.covariance)
    absolute = change.drift_change(scanner, calibrated, covariance, fit, radius_mm=radius_mm)
    method: DriftMethod = "opposite-rays" if isinstance(fit, change.ConjugateFit) else "view-pairs"
    baseline = next((each for each in baselines if each.method == method), None)
    changed, zero = absolute, None
    if baseline is not None:
        changed = change.drift_change(scanner, calibrated, covariance, fit, zero=baseline.offset, radius_mm=radius_mm)
        zero = drifts.DriftBaseline(
            **dict(baseline),
            ray_offset_mm=change.zero_offset_mm(scanner, calibrated, baseline.offset, radius_mm=radius_mm),
            change=_detector(changed.change),
            change_standard_deviation=_deviation(fit, changed.deviation),
            significance=_deviation(fit, changed.significance),
        )
    turned_over = fit.rotation is not calibration.rotation
    within = None if nominal else _within(changed, reference, zero, turned_over=turned_over)
    if nominal is None:
        of_detector = _of_the_detector(reference, changed, zero, within=within, turned_over=turned_over)
        of_turn = change.disturbed_turn(fit)
        reason: str = LogMessage.DISTURBED_TURN(of_detector, *of_turn) if of_turn else of_detector
    else:
        reason = found_column(nominal, fit)
    return drifts.DriftResult(
        measured=_detector(change.seen_vector(fit)),
        standard_deviation=_deviation(fit, fit.deviation),
        covariance=fit.covariance.tolist(),
        calibrated=_detector(change.seen_vector(calibrated)),
        change=_detector(absolute.change),
        change_standard_deviation=_deviation(fit, absolute.deviation),
        significance=_deviation(fit, absolute.significance),
        reference="given-geometry" if nominal else "calibration" if zero is None else "baseline",
        theta=None if nominal is None else corrected_theta(nominal, fit),
        baseline=zero,
        moved=changed.moved and nominal is None,
        ray_change_mm=changed.ray_change_mm,
        ray_change_uncertainty_mm=changed.ray_change_uncertainty_mm,
        contrast_loss=None if nominal else changed.contrast_loss,
        scale_change_percent=100.0 * changed.scale_change,
        scale_change_uncertainty_percent=100.0 * TWO_SIDED_95 * changed.scale_deviation,
        radius_mm=radius_mm,
        tolerance_mm=tolerance_mm,
        within_tolerance=within,
        reason=reason,
        coded_reason=CodedReason.of(reason) if nominal is None else None,
        method=method,
        not_seen=_not_seen(fit, zero),
        rotation=fit.rotation,
        rotation_ratio=fit.rotation_ratio,
        rotation_decided=fit.rotation_decided,
        relative_residual=fit.relative_residual,
        encoder_bound_mm=fit.encoder_bound_mm,
        disturbances=[_disturbance(each, amplitude) for each, amplitude in fit.disturbances.items()],
        adjustments=[*(() if scan.averaged_rows is None else scan.remarks), *mean.remarks, *fit.adjustments],
        scanner=scanner,
        views=int(angles_rad.size),
        rows=scan.rows,
        time_s=time.perf_counter() - started,
        software_version=VERSION,
        input_sha256=scan.sha256,
    )


def mean_of_common_rows(
    stack: NDArray[np.float32], first_row: int, row_step: int = 1, deviations: NDArray[np.float32] | None = None
) -> CommonMean:
    """Average the rows (views, rows, detector) that every view has: views must cross the same part of the log."""
    common = present_rows(stack).all(axis=0)
    if not common.any():
        last = first_row + (common.size - 1) * row_step
        raise refused("rows-missing", f"no row from {first_row} to {last} is in every view: give others with rows")
    left_out = first_row + row_step * np.flatnonzero(~common)
    remarks = (f"rows {', '.join(map(str, left_out))} were left out, which some views lack",) if left_out.size else ()
    # Where no row is missing, this is a view of the stack: nothing is copied.
    mean = (stack[:, common] if left_out.size else stack).mean(axis=1, dtype=np.float64)
    if deviations is None:
        return CommonMean(mean, None, remarks)
    return CommonMean(mean, np.linalg.norm(deviations[:, common].astype(np.float64), axis=1) / common.sum(), remarks)


def _within(
    changed: change.DriftChange, reference: _Reference, zero: drifts.DriftBaseline | None, *, turned_over: bool
) -> bool | None:
    # A scale that this scan hardly determines is no reason for an alarm, and neither are rays.
    allowed = max(reference.tolerance_scale_percent / 100.0, change.SIGNIFICANT * changed.scale_deviation)
    if turned_over or _is_far(zero, reference) or abs(changed.scale_change) > allowed:
        return False
    limit_mm, error_mm = _limit_mm(reference, changed), TWO_SIDED_95 * changed.ray_change_uncertainty_mm
    if changed.ray_change_mm > limit_mm:
        return False if changed.moved else None
    return True if error_mm <= limit_mm else None


def _limit_mm(reference: _Reference, changed: change.DriftChange) -> float:
    """Return the distance in mm that a log must see: without a movement that of a calibration that passes."""
    if changed.moved:
        return reference.tolerance_mm
    return min(reference.tolerance_mm, _calibration_limit_mm(reference.calibration))


def _calibration_limit_mm(calibration: KnownGeometry) -> float:
    limits = None if isinstance(calibration, GivenGeometry) else calibration.limits
    return Tolerances().predicted_ray_error_mm if limits is None else limits.tolerance_mm


def _is_far(zero: drifts.DriftBaseline | None, reference: _Reference) -> bool:
    """Return whether the first logs were already out of tolerance: a baseline must not hide an earlier move."""
    return zero is not None and zero.ray_offset_mm > reference.tolerance_mm


def _of_the_detector(
    reference: _Reference,
    changed: change.DriftChange,
    zero: drifts.DriftBaseline | None,
    *,
    within: bool | None,
    turned_over: bool,
) -> Reason:
    allowed_mm = reference.tolerance_mm
    if turned_over:
        return LogMessage.TURNED_OVER()
    if zero is not None and _is_far(zero, reference):
        return LogMessage.MOVED_BEFORE(looks=zero.checks, offset_mm=zero.ray_offset_mm, allowed_mm=allowed_mm)
    moved: dict[str, Value] = {"moved_mm": changed.ray_change_mm, "allowed_mm": allowed_mm}
    lost = {"loss_percent": changed.contrast_loss.knot_10_mm_percent}
    if within is None:
        known = {"moved_mm": changed.ray_change_mm, "allowed_mm": _limit_mm(reference, changed)}
        return LogMessage.UNCERTAIN(**known, error_mm=TWO_SIDED_95 * changed.ray_change_uncertainty_mm)
    cause = change.likely_cause(reference.calibration.source_frame, changed)
    if not within and changed.ray_change_mm > allowed_mm:
        cause = LogMessage.MOVED(cause, **moved)
    elif not within:
        allowed_percent = reference.tolerance_scale_percent
        cause = LogMessage.RESCALED(cause, scale_percent=100.0 * changed.scale_change, allowed_percent=allowed_percent)
    elif changed.moved and changed.contrast_loss.matters:
        cause = LogMessage.CALIBRATE_SOON(cause, **moved, **lost)
    elif changed.ray_change_mm > (limit_mm := _calibration_limit_mm(reference.calibration)):
        cause = LogMessage.BEYOND_CALIBRATION(cause, **moved, limit_mm=limit_mm)
    elif changed.moved:
        cause = LogMessage.WITHIN(cause, **moved)
    if not within and changed.contrast_loss.matters:
        cause = LogMessage.LOST_CONTRAST(cause, **lost)
    return cause if zero is None else LogMessage.SINCE_BASELINE(cause, looks=zero.checks)


def _not_seen(fit: change.DetectorFit, zero: drifts.DriftBaseline | None) -> list[str]:
    of_flat_field = change.FLAT_FIELD_NOT_SEEN if zero is None else change.FLAT_FIELD_CHANGE_NOT_SEEN
    return [
        *change.NOT_SEEN,
        *([change.DISTANCE_NOT_SEEN] if fit.distance_held else []),
        *([] if isinstance(fit, change.ConjugateFit) else [of_flat_field, change.ENCODER_NOT_SEEN]),
    ]


def _disturbance(each: change.Disturbance, amplitude: float) -> drifts.TurnDisturbance:
    size = {"amplitude_deg" if each.part == "encoder" else "amplitude_mm": amplitude}
    return drifts.TurnDisturbance(part=each.part, times_a_turn=each.order, **size)


def _detector(values: FloatArray) -> drifts.DetectorGeometry:
    column, tilt, distance = (float(value) for value in values)
    return drifts.DetectorGeometry(cor_column_mm=column, tilt_rad=tilt, source_to_detector_mm=distance)


def _deviation(fit: change.DetectorFit, values: FloatArray) -> drifts.DetectorDeviation:
    column, tilt, distance = (float(value) for value in values)
    return drifts.DetectorDeviation(
        cor_column_mm=column, tilt_rad=tilt, source_to_detector_mm=None if fit.distance_held else distance
    )


def with_coarse_column(
    scanner: Scanner, frame: SourceFrame, sinogram: FloatArray, angles_rad: FloatArray
) -> SourceFrame:
    """Replace u_c by the column about which the centres of mass of the views oscillate once per turn.

    The centre of mass of a body rotates about the COR, so its shadow oscillates about u_c; the fan's second order
    cancels over a full turn (first-order Helgason-Ludwig condition, Natterer 2001, section 2.1). The fits need u_c
    to a few hundredths of the detector.
    """
    u = cell_centres_mm(scanner)
    lines = np.where(np.isfinite(sinogram), sinogram, 0.0)
    mass = lines.sum(axis=1)
    heavy = mass > 0.5 * np.median(mass)
    if not heavy.any():  # no body: the fits refuse the scan
        return frame
    centres = lines[heavy] @ u / mass[heavy]
    phi = angles_rad[heavy]
    column = float(np.linalg.lstsq(np.stack([np.ones_like(phi), np.cos(phi), np.sin(phi)], -1), centres)[0][0])
    return replace(frame, cor_column_mm=float(np.clip(column, u[0], u[-1])))


def corrected_theta(geometry: GivenGeometry, fit: change.DetectorFit) -> Theta:
    """Set u_c and tau to the scan's values at the given SDD, which a ruler measures better than a log shows it."""
    detector = fit.at_distance(geometry.source_frame.source_to_detector_mm)
    corrected = replace(geometry.source_frame, cor_column_mm=detector.cor_column_mm, tilt_rad=detector.tilt_rad)
    sign = int(math.copysign(1, geometry.theta.source_shift_mm))
    return corrected.theta(geometry.scanner.source_to_cor_mm, source_shift_sign=sign)


def found_column(geometry: GivenGeometry, fit: change.DetectorFit) -> str:
    """Describe what was found and what was kept, in one sentence each, with the `--theta` for a reconstruction."""
    theta, given_sdd_mm = corrected_theta(geometry, fit), geometry.source_frame.source_to_detector_mm
    detector = fit.at_distance(given_sdd_mm)
    (column, tilt), (column_deviation, tilt_deviation) = detector.values, detector.deviations
    turned = "" if fit.rotation is Rotation.AS_GIVEN else f" --rotation {fit.rotation.value}"
    sentence = (
        f"the COR falls on the detector at u_c {column:.4g} ± {column_deviation:.2g} mm with a tilt "
        f"of {math.degrees(tilt):.3g} ± {math.degrees(tilt_deviation):.2g} degrees (standard deviations): reconstruct "
        f"with --theta {theta.written()}{turned}, in which these two are measured, and R, SDD and the first angle are "
        "as given"
    )
    if fit.rotation is not geometry.rotation:
        sentence += f"; the views turn {fit.rotation.value}, not {geometry.rotation.value}"
    distance, deviation = fit.source_to_detector_mm, fit.deviation[2]
    if abs(distance - given_sdd_mm) > change.SIGNIFICANT * deviation > 0.0:
        sentence += f"; the scan itself shows an SDD of {distance:.5g} ± {deviation:.2g} mm: check the distances"
    return sentence
