"""A calibration's numbers as people read them."""

import math

from worker.contracts.calibrations import CalibrationResult


def report_table(result: CalibrationResult) -> list[tuple[str, str]]:
    """Labels and values, standard deviations beside them where they are known."""
    theta, frame = result.theta, result.source_frame
    theta_sd = result.standard_deviation.theta if result.standard_deviation else None
    frame_sd = result.standard_deviation.source_frame if result.standard_deviation else None

    def of(group: object, name: str) -> float | None:
        return getattr(group, name, None)

    rows = [
        ("first angle alpha0", _degrees(theta.initial_angle_rad, of(theta_sd, "initial_angle_rad"))),
        ("COR to detector r_D", _mm(theta.detector_to_cor_mm, of(theta_sd, "detector_to_cor_mm"))),
        ("source shift h_S", _mm(theta.source_shift_mm, of(theta_sd, "source_shift_mm"))),
        ("detector shift h_D", _mm(theta.detector_shift_mm, of(theta_sd, "detector_shift_mm"))),
        ("detector tilt alpha_D", _value(theta.detector_tilt, of(theta_sd, "detector_tilt"), "", 5)),
        ("source distance R", _mm(frame.source_distance_mm, of(frame_sd, "source_distance_mm"))),
        ("  from the phantom's size", f"± {result.scale_uncertainty_mm:.3g} mm (systematic)"),
        ("source to detector", _mm(frame.source_to_detector_mm, of(frame_sd, "source_to_detector_mm"))),
        ("COR on the detector", _mm(frame.cor_column_mm, of(frame_sd, "cor_column_mm"))),
        ("tilt in the source frame", _degrees(frame.tilt_rad, of(frame_sd, "tilt_rad"))),
    ]
    if result.predicted_ray_error_mm is not None:
        predicted = result.predicted_ray_error_mm
        rows.append(("predicted ray error", f"{predicted.rms:.4f} mm RMS, 95 % below {predicted.upper_95:.4f} mm"))
        rows.append(("  from the phantom's size", f"± {result.scale_ray_error_mm:.3g} mm RMS (systematic)"))
    rows += [
        ("seen / turning", f"{result.handedness.value} / {result.rotation.value}"),
        ("phantom's position", "({:.2f}, {:.2f}) mm".format(*result.phantom_position_mm)),
        ("residual", f"{result.residual.relative:.3%} of the sinogram"),
        ("views, rows", f"{result.views}, {result.rows[0]}:{result.rows[1]}"),
        ("time", f"{result.timing_s.total:.2f} s"),
    ]
    return rows


def _value(value: float, deviation: float | None, unit: str, digits: int = 3) -> str:
    spread = "" if deviation is None else f" ± {deviation:.2g}"
    return f"{value:.{digits}f}{spread}{' ' + unit if unit else ''}"


def _mm(value: float, deviation: float | None) -> str:
    return _value(value, deviation, "mm")


def _degrees(value_rad: float, deviation_rad: float | None) -> str:
    spread = None if deviation_rad is None else math.degrees(deviation_rad)
    return _value(math.degrees(value_rad), spread, "°", 4)
