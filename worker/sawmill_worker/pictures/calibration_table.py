"""Readable table of a calibration's numbers."""

import math

from sawmill_contracts.calibrations import CalibrationResult


def calibration_table(result: CalibrationResult) -> list[tuple[str, str]]:
    """Return labels and values, with standard deviations where these are known."""
    theta, frame = result.theta, result.source_frame
    theta_sd, frame_sd = result.deviations.theta, result.deviations.source_frame
    # The angle whose tangent is a slope s has the deviation ds / (1 + s²).
    slope = theta_sd.detector_tilt
    tilt_sd = None if slope is None else slope / (1.0 + theta.detector_tilt**2)
    rows = [
        ("first angle alpha0", _degrees(theta.initial_angle_rad, theta_sd.initial_angle_rad)),
        ("COR to detector r_D", _mm(theta.detector_to_cor_mm, theta_sd.detector_to_cor_mm)),
        ("source shift h_S", _mm(theta.source_shift_mm, theta_sd.source_shift_mm)),
        ("detector shift h_D", _mm(theta.detector_shift_mm, theta_sd.detector_shift_mm)),
        ("detector tilt alpha_D", _degrees(math.atan(theta.detector_tilt), tilt_sd)),
        ("source distance R", _mm(frame.source_distance_mm, frame_sd.source_distance_mm)),
        ("  from the phantom's size", f"± {result.scale_uncertainty_mm:.3g} mm (systematic)"),
        ("source to detector", _mm(frame.source_to_detector_mm, frame_sd.source_to_detector_mm)),
        ("COR on the detector", _mm(frame.cor_column_mm, frame_sd.cor_column_mm)),
        ("tilt in the source frame", _degrees(frame.tilt_rad, frame_sd.tilt_rad)),
    ]
    if (error := result.predicted_ray_error_mm) is not None:
        rows.append(("predicted ray error", f"{error.rms:.4f} mm RMS, 95 % below {error.upper_95:.4f} mm"))
    rows.append(("ray error from phantom size", f"± {result.scale_ray_error_mm:.3g} mm RMS (systematic)"))
    if result.scale_uncertainty_percent is not None:
        rows.append(("scale of the image", f"± {result.scale_uncertainty_percent:.2g} % (95 %)"))
    if result.status is not None:
        rows.append(("status", str(result.status)))
    rows.append(("seen / turning", f"{result.handedness} / {result.rotation}"))
    for second in result.hypotheses[1:2]:
        unexplained = f"{second.relative_residual:.2%} unexplained"
        rows.append(("  next best", f"{second.handedness} / {second.rotation}, {unexplained}"))
    return [
        *rows,
        ("phantom's position", "({:.2f}, {:.2f}) mm".format(*result.phantom_position_mm)),
        ("residual", f"{result.residual.relative:.3%} of the sinogram"),
        ("views, rows", "{}, {}:{}".format(result.views, *result.rows)),
        ("time", f"{result.timing_s.total:.2f} s"),
    ]


def _mm(value: float, deviation: float | None) -> str:
    return f"{value:.3f}{'' if deviation is None else f' ± {deviation:.2g}'} mm"


def _degrees(value_rad: float, deviation_rad: float | None) -> str:
    spread = "" if deviation_rad is None else f" ± {math.degrees(deviation_rad):.2g}"
    return f"{math.degrees(value_rad):.4f}{spread} °"
