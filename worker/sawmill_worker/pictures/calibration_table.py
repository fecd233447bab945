"""A calibration's numbers as people read them."""

import math
from collections.abc import Mapping
from typing import Any

Answer = Mapping[str, Any]


def calibration_table(answer: Answer) -> list[tuple[str, str]]:
    """Labels and values, standard deviations beside them where they are known.

    Parameters
    ----------
    answer : mapping
        A calibration's answer as JSON has it, the units in the names.
    """
    theta, frame = answer["theta"], answer["source_frame"]
    deviations = answer["standard_deviation"] or {"theta": {}, "source_frame": {}}
    theta_sd, frame_sd = deviations["theta"], deviations["source_frame"]
    rows = [
        ("first angle alpha0", _degrees("initial_angle_rad", theta, theta_sd)),
        ("COR to detector r_D", _mm("detector_to_cor_mm", theta, theta_sd)),
        ("source shift h_S", _mm("source_shift_mm", theta, theta_sd)),
        ("detector shift h_D", _mm("detector_shift_mm", theta, theta_sd)),
        ("detector tilt alpha_D", _value(theta["detector_tilt"], theta_sd.get("detector_tilt"), "", 5)),
        ("source distance R", _mm("source_distance_mm", frame, frame_sd)),
        ("  from the phantom's size", f"± {answer['scale_uncertainty_mm']:.3g} mm (systematic)"),
        ("source to detector", _mm("source_to_detector_mm", frame, frame_sd)),
        ("COR on the detector", _mm("cor_column_mm", frame, frame_sd)),
        ("tilt in the source frame", _degrees("tilt_rad", frame, frame_sd)),
    ]
    predicted = answer["predicted_ray_error_mm"]
    if predicted is not None:
        bound = f"95 % below {predicted['upper_95']:.4f} mm"
        rows.append(("predicted ray error", f"{predicted['rms']:.4f} mm RMS, {bound}"))
        rows.append(("  from the phantom's size", f"± {answer['scale_ray_error_mm']:.3g} mm RMS (systematic)"))
    return [*rows, *_circumstances(answer)]


def _circumstances(answer: Answer) -> list[tuple[str, str]]:
    status = answer.get("status")
    rows = [] if status is None else [("status", status)]
    rows.append(("seen / turning", f"{answer['handedness']} / {answer['rotation']}"))
    if len(answer["hypotheses"]) > 1:
        second = answer["hypotheses"][1]
        left = f"{second['relative_residual']:.2%} unexplained"
        rows.append(("  next best", f"{second['handedness']} / {second['rotation']}, {left}"))
    return [
        *rows,
        ("phantom's position", "({:.2f}, {:.2f}) mm".format(*answer["phantom_position_mm"])),
        ("residual", f"{answer['residual']['relative']:.3%} of the sinogram"),
        ("views, rows", "{}, {}:{}".format(answer["views"], *answer["rows"])),
        ("time", f"{answer['timing_s']['total']:.2f} s"),
    ]


def _value(value: float, deviation: float | None, unit: str, digits: int = 3) -> str:
    spread = "" if deviation is None else f" ± {deviation:.2g}"
    return f"{value:.{digits}f}{spread}{' ' + unit if unit else ''}"


def _mm(name: str, values: Answer, deviations: Answer) -> str:
    return _value(values[name], deviations.get(name), "mm")


def _degrees(name: str, values: Answer, deviations: Answer) -> str:
    deviation = deviations.get(name)
    spread = None if deviation is None else math.degrees(deviation)
    return _value(math.degrees(values[name]), spread, "°", 4)
