"""What the jobs answer, as a worker stores it: one place for all tests that need an answer and no science.

Each function returns a fresh JSON document; keyword arguments replace fields.
"""

from collections.abc import Callable
from typing import Any

from sawmill_contracts import kinds
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of

CONSTANTS = {"source_to_cor_mm": 859.46, "num_detector_pixels": 768, "detector_pitch_mm": 1.5}
SCANNER_FORM = {name: str(value) for name, value in CONSTANTS.items()} | {
    "name": "Line 2",
    "ray_error_mm": "0.1",
    "scale_percent": "0.5",
    "ray_change_mm": "0.4",
}
SCANNER_SPEC = {"name": "Line 2", "constants": CONSTANTS}
THETA = {
    "initial_angle_rad": 2.55,
    "detector_to_cor_mm": 714.7,
    "source_shift_mm": 319.9,
    "detector_shift_mm": 43.7,
    "detector_tilt": 0.281,
}
FRAME = {
    "psi_rad": 2.907,
    "source_distance_mm": 917.1,
    "source_to_detector_mm": 1619.3,
    "cor_column_mm": -209.1,
    "tilt_rad": -0.083,
    "magnification": 1.766,
}
SEARCH = {
    "method": "default",
    "seed": 7,
    "evaluations": 1,
    "generations": 1,
    "best_value": 0.0,
    "converged": True,
    "message": "converged",
}


def comparison(moved_mm: float = 0.05, **changes: Any) -> dict[str, Any]:
    """Compare with the calibration `example`, which allows 0.5 mm."""
    return {
        "calibration_id": "example",
        "ray_change_mm": moved_mm,
        "angle_change_deg": 0.1,
        "cor_column_change_mm": -1.25,
        "source_distance_change_mm": 2.5,
        "tilt_change_deg": 0.05,
        "tolerance_mm": 0.5,
        "within_tolerance": moved_mm < 0.5,
        "reason": f"the rays moved by {moved_mm} mm <RMS>",
    } | changes


def reading(**changes: Any) -> dict[str, Any]:
    return {
        "format": "NXtomo",
        "shape": {"views": 20, "rows": 1, "detector": 768},
        "angular_range_deg": (0.0, 342.0),
        "remarks": ["one invalid frame left out"],
    } | changes


def calibration_result(**changes: Any) -> dict[str, Any]:
    return {
        "theta": THETA,
        "theta_twin": None,
        "source_frame": FRAME,
        "standard_deviation": {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)},
        "covariance": [[0.0] * 5] * 5,
        "unconstrained_source_distance_mm": 917.1,
        "scale_uncertainty_mm": 0.9,
        "scale_ray_error_mm": 0.05,
        "scale_uncertainty_percent": 0.3,
        "predicted_ray_error_mm": {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0},
        "handedness": "as-drawn",
        "rotation": "as-given",
        "hypotheses": [],
        "phantom_position_mm": (0.0, 0.0),
        "gain": 1.0,
        "offset": 0.0,
        "residual": {"rms": 0.1, "relative": 0.001},
        "status": "calibrated",
        "verdict": "pass",
        "reasons": [],
        "scanner": CONSTANTS,
        "phantom": "L-shape",
        "views": 20,
        "rows": (0, 1),
        "search": SEARCH,
        "timing_s": {"total": 1.0, "search": 0.5, "refine": 0.4, "uncertainty": 0.1},
        "software_version": "0",
        "input_sha256": "0" * 64,
    } | changes


def reconstruction_result(**changes: Any) -> dict[str, Any]:
    return {
        "shape": (1, 16, 16),
        "pixel_mm": 1.0,
        "unit": "1/mm",
        "value_range": (0.0, 1.0),
        "theta": THETA,
        "rotation": "as-given",
        "handedness": "as-drawn",
        "views": 20,
        "rows": (0, 1),
        "time_s": 0.1,
        "software_version": "0",
        "input_sha256": "0" * 64,
    } | changes


def plan_result(**changes: Any) -> dict[str, Any]:
    known = calibration_result()
    kept = (
        "theta",
        "source_frame",
        "standard_deviation",
        "covariance",
        "predicted_ray_error_mm",
        "scale_uncertainty_mm",
        "scale_ray_error_mm",
        "scale_uncertainty_percent",
        "scanner",
        "phantom",
        "software_version",
    )
    return (
        {name: known[name] for name in kept}
        | {"noise_mm": 2.1, "views_cut_off": 0, "views": 20, "noise": 0.02}
        | changes
    )


def drift_result(**changes: Any) -> dict[str, Any]:
    three = {"cor_column_mm": -209.1, "tilt_rad": -0.083, "source_to_detector_mm": 1619.3}
    of_three = ("change", "change_standard_deviation", "significance")
    return {
        "measured": three,
        "standard_deviation": dict.fromkeys(three, 0.1),
        "covariance": [[0.0] * 3] * 3,
        "calibrated": three,
        **dict.fromkeys(of_three, dict.fromkeys(three, 0.1)),
        "moved": False,
        "ray_change_mm": 0.01,
        "ray_change_uncertainty_mm": 0.02,
        "radius_mm": 150.0,
        "tolerance_mm": 0.5,
        "within_tolerance": True,
        "reason": "nothing moved",
        "not_seen": ["R"],
        "rotation": "as-given",
        "rotation_ratio": 60.0,
        "rotation_decided": True,
        "relative_residual": 0.01,
        "adjustments": [],
        "scanner": CONSTANTS,
        "views": 120,
        "rows": (0, 1),
        "time_s": 0.1,
        "software_version": "0",
        "input_sha256": "0" * 64,
    } | changes


def inspection_result(**changes: Any) -> dict[str, Any]:
    missing = {"what": "what the numbers are", "flag": "--data counts", "field": "data", "why": "never guessed"}
    return {
        "file": "scan.npz",
        "size_bytes": 8,
        "format": "NPZ",
        "verdict": "incomplete",
        "parts": [{"name": "projections", "kind": "array", "shape": (12, 4, 16), "type": "uint16"}],
        "reading": {"shape": {"views": 12, "rows": 4, "detector": 16}, "flats": 1},
        "missing": [missing],
    } | changes


def answer_of(kind: JobKind, result: dict[str, Any]) -> Contract:
    """A result as the supervisor passes it on: read by the contract of its kind."""
    return declaration_of(kind).result.model_validate(result)


RESULTS: dict[JobKind, Callable[..., dict[str, Any]]] = {
    kinds.INGEST: reading,
    kinds.CALIBRATE: calibration_result,
    kinds.RECONSTRUCT: reconstruction_result,
    kinds.PLAN: plan_result,
    kinds.DRIFT: drift_result,
    kinds.INSPECT: inspection_result,
    kinds.TRACE_PHANTOM: lambda: {"name": "traced", "shapes": [{"kind": "disc", "center_mm": (0, 0), "radius_mm": 50}]},
}
