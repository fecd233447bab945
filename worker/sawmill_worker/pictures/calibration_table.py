"""Readable table of a calibration's numbers."""

import math

from sawmill_contracts.calibrations import CalibrationResult


def calibration_table(result: CalibrationResult) -> list[tuple[str, str]]:
    """Return labels and values, with standard deviations where these are known."""
    theta, frame = result.theta, result.source_frame
    theta_sd, frame_sd = result.deviations.theta, result.deviations.source_frame
    rows = [
        ("first angle alpha0", _degrees(theta.initial_angle_rad, theta_sd.initial_angle_rad)),
        ("COR to detector r_D", _mm(theta.detector_to_cor_mm, theta_sd.detector_to_cor_mm)),
        ("source shift h_S", _mm(theta.source_shift_mm, theta_sd.source_shift_mm)),
        ("detector shift h_D", _mm(theta.detector_shift_mm, theta_sd.detector_shift_mm)),
        ("detector tilt alpha_D", _slope(theta.detector_tilt, theta_sd.detector_tilt)),
        ("source distance R", _mm(frame.source_distance_mm, frame_sd.source_distance_mm)),
        ("  from the phantom's size", f"± {result.scale_uncertainty_mm:.3g} mm (systematic)"),
        ("source to detector", _mm(frame.source_to_detector_mm, frame_sd.source_to_detector_mm)),
        ("COR on the detector", _mm(frame.cor_column_mm, frame_sd.cor_column_mm)),
        ("tilt in the source frame", _degrees(frame.tilt_rad, frame_sd.tilt_rad)),
    ]
    predicted = result.predicted_ray_error_mm
    if predicted is not None:
        bound = f"95 % below {predicted.upper_95:.4f} mm"
        rows.append(("predicted ray error", f"{predicted.rms:.4f} mm RMS, {bound}"))
    rows.append(("ray error from phantom size", f"± {result.scale_ray_error_mm:.3g} mm RMS (systematic)"))
    if result.scale_uncertainty_percent is not None:
        rows.append(("scale of the image", f"± {result.scale_uncertainty_percent:.2g} % (95 %)"))
    return [*rows, *_circumstances(result)]


def _circumstances(result: CalibrationResult) -> list[tuple[str, str]]:
    rows = [] if result.status is None else [("status", str(result.status))]
    rows.append(("seen / turning", f"{result.handedness} / {result.rotation}"))
    if len(result.hypotheses) > 1:
        second = result.hypotheses[1]
        unexplained = f"{second.relative_residual:.2%} unexplained"
        rows.append(("  next best", f"{second.handedness} / {second.rotation}, {unexplained}"))
    return [
        *rows,
        ("phantom's position", "({:.2f}, {:.2f}) mm".format(*result.phantom_position_mm)),
        ("residual", f"{result.residual.relative:.3%} of the sinogram"),
        ("views, rows", "{}, {}:{}".format(result.views, *result.rows)),
        ("time", f"{result.timing_s.total:.2f} s"),
    ]


def _value(value: float, deviation: float | None, unit: str, digits: int = 3) -> str:
    spread = "" if deviation is None else f" ± {deviation:.2g}"
    return f"{value:.{digits}f}{spread}{' ' + unit if unit else ''}"


def _mm(value: float, deviation: float | None) -> str:
    return _value(value, deviation, "mm")


def _degrees(value_rad: float, deviation_rad: float | None) -> str:
    return _value(math.degrees(value_rad), None if deviation_rad is None else math.degrees(deviation_rad), "°", 4)


def _slope(value: float, deviation: float | None) -> str:
    """Format a slope as an angle, with d atan(s) = ds / (1 + s²)."""
    return _degrees(math.atan(value), None if deviation is None else deviation / (1.0 + value**2))
