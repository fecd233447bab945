"""What jobs answer, as a worker stores it: each function returns a fresh JSON document with other fields as asked."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.reasons import CodedReason
from sawmill_formats.nexus import PACKED
from sawmill_formats.output.calibration_file import write_calibration
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.files.verified_results import compute_digest
from sawmill_platform.jobs.job_store import Claim
from sawmill_store.store import Store
from sawmill_vocabulary import SourceFrame, Theta
from sawmill_vocabulary.pair_messages import PairMessage

CONSTANTS = {"source_to_cor_mm": 859.46, "num_detector_pixels": 768, "detector_pitch_mm": 1.5}
SCANNER_FORM = {name: str(value) for name, value in CONSTANTS.items()} | {"name": "Line 2"}
SCANNER_FORM |= {"ray_error_mm": "0.1", "scale_percent": "0.5", "ray_change_mm": "0.4"}
SCANNER_SPEC = {"name": "Line 2", "constants": CONSTANTS}
THETA = dict(vars(Theta(2.55, 714.7, 319.9, 43.7, 0.281)))
FRAME = vars(SourceFrame(2.907, 917.1, 1619.3, -209.1, -0.083)) | {"magnification": 1.766}
SEARCH = {"method": "default", "seed": 7, "evaluations": 1, "generations": 1, "best_value": 0.0}
SEARCH |= {"converged": True, "message": "converged"}
BY_SOFTWARE = {"software_version": "0", "input_sha256": "0" * 64}


def comparison(moved_mm: float = 0.05, **changes: Any) -> dict[str, Any]:
    """Compare with the calibration `example`, which allows 0.5 mm."""
    moved = {"ray_change_mm": moved_mm, "angle_change_deg": 0.1, "cor_column_change_mm": -1.25}
    moved |= {"source_distance_change_mm": 2.5, "tilt_change_deg": 0.05}
    judged = {"tolerance_mm": 0.5, "within_tolerance": moved_mm < 0.5, "calibration_id": "example"}
    return {**moved, **judged, "reason": f"the rays moved by {moved_mm} mm <RMS>"} | changes


def reading(**changes: Any) -> dict[str, Any]:
    read = {"format": "NXtomo", "shape": {"views": 20, "rows": 1, "detector": 768}, "angular_range_deg": (0.0, 342.0)}
    return {**read, "remarks": ["one invalid frame left out"]} | changes


def calibration_result(**changes: Any) -> dict[str, Any]:
    deviations = {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)}
    geometry = {"theta": THETA, "theta_twin": None, "source_frame": FRAME, "standard_deviation": deviations}
    scale = {"unconstrained_source_distance_mm": 917.1, "scale_uncertainty_mm": 0.9, "scale_ray_error_mm": 0.05}
    scale |= {"scale_uncertainty_percent": 0.3, "covariance": [[0.0] * 5] * 5}
    rays = {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0}
    fit = {"handedness": "as-drawn", "rotation": "as-given", "hypotheses": [], "phantom_position_mm": (0.0, 0.0)}
    fit |= {"gain": 1.0, "offset": 0.0, "residual": {"rms": 0.1, "relative": 0.001}, "predicted_ray_error_mm": rays}
    end = {"status": "calibrated", "verdict": "pass", "reasons": [], "search": SEARCH, **BY_SOFTWARE}
    end |= {"timing_s": {"total": 1.0, "search": 0.5, "refine": 0.4, "uncertainty": 0.1}}
    given = {"scanner": CONSTANTS, "phantom": "L-shape", "views": 20, "rows": (0, 1)}
    return {**geometry, **scale, **fit, **end, **given} | changes


def reconstruction_result(**changes: Any) -> dict[str, Any]:
    volume = {"shape": (1, 16, 16), "pixel_mm": 1.0, "unit": "1/mm", "value_range": (0.0, 1.0)}
    given = {"theta": THETA, "rotation": "as-given", "handedness": "as-drawn", "views": 20, "rows": (0, 1)}
    return {**volume, **given, "time_s": 0.1, **BY_SOFTWARE} | changes


def plan_result(**changes: Any) -> dict[str, Any]:
    known = calibration_result()
    scale = ("scale_uncertainty_mm", "scale_ray_error_mm", "scale_uncertainty_percent")
    kept = ("theta", "source_frame", "standard_deviation", "covariance", "predicted_ray_error_mm", "scanner", "phantom")
    planned = {"noise_mm": 2.1, "views_cut_off": 0, "views": 20, "noise": 0.02}
    return {name: known[name] for name in (*kept, *scale, "software_version")} | planned | changes


def drift_result(**changes: Any) -> dict[str, Any]:
    three = {"cor_column_mm": -209.1, "tilt_rad": -0.083, "source_to_detector_mm": 1619.3}
    of_three = ("standard_deviation", "change", "change_standard_deviation", "significance")
    found = {"measured": three, "calibrated": three, **dict.fromkeys(of_three, dict.fromkeys(three, 0.1))}
    rays = {"ray_change_mm": 0.01, "ray_change_uncertainty_mm": 0.02, "radius_mm": 150.0, "tolerance_mm": 0.5}
    judged = {"moved": False, "within_tolerance": True, "reason": "nothing moved", "not_seen": ["R"], "adjustments": []}
    turn = {"rotation": "as-given", "rotation_ratio": 60.0, "rotation_decided": True}
    about = {"relative_residual": 0.01, "covariance": [[0.0] * 3] * 3, "time_s": 0.1, **BY_SOFTWARE}
    given = {"scanner": CONSTANTS, "views": 120, "rows": (0, 1)}
    return {**found, **rays, **judged, **turn, **about, **given} | changes


def fixed_pairs_result(**changes: Any) -> dict[str, Any]:
    """Two pairs after one passage: not precise enough yet."""
    rays = {"predicted_rms_mm": 0.2, "upper_95_mm": 0.31}
    deviation = dict.fromkeys(FRAME, 0.1)
    pair = {"source_frame": FRAME, "standard_deviation": deviation, "cell_order": "clockwise", "order_deviations": 9.5}
    roll = PairMessage.ROLL_AGAIN(upper_mm=0.31, allowed_mm=0.1, rms_mm=0.2, passages=1)
    judged = {"verdict": "watch", "reasons": [str(roll)], "coded_reasons": [CodedReason.of(roll).model_dump()]}
    board = {"passages": [{"x_mm": 1.0, "y_mm": -2.0, "roll_deg": 30.0}], "phantom": "L-shape", "log_radius_mm": 180.0}
    board |= {"outline_mm": [[(-90.0, -90.0), (90.0, -90.0), (0.0, 90.0)]], "rows": [(1, 11)] * 2, "options": {}}
    fit = {"scale_uncertainty_percent": 0.4, "corners_rms_mm": 0.1, "residual_percent": 0.5}
    return {**rays, "pairs": [pair | rays] * 2, **judged, **board, **fit} | changes


def pair_log_result(**changes: Any) -> dict[str, Any]:
    """Two marks of two pairs, which show no motion; one of them may be elsewhere."""
    mark = {"place_mm": (30.0, -20.0, 12.0), "deviations_mm": (0.4, 0.3, 0.8), "pairs": [1, 2], "residual_mm": 0.0}
    marks = [mark | {"is_ambiguous": elsewhere} for elsewhere in (False, True)]
    return {"marks": marks, "unplaced": 1, "agreement": {"state": "unknown"}} | changes


def inspection_result(**changes: Any) -> dict[str, Any]:
    missing = {"name": "what the numbers are", "flag": "--data counts", "field": "data", "why": "never guessed"}
    part = {"name": "projections", "kind": "array", "shape": (12, 4, 16), "type": "uint16"}
    read = {"shape": {"views": 12, "rows": 4, "detector": 16}, "flats": 1}
    about = {"file": "scan.npz", "size_bytes": 8, "format": "NPZ", "verdict": "incomplete"}
    return {**about, "parts": [part], "reading": read, "missing": [missing]} | changes


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
    kinds.CALIBRATE_PAIRS: fixed_pairs_result,
    kinds.LOCATE_MARKS: pair_log_result,
    kinds.TRACE_PHANTOM: lambda: {"name": "traced", "shapes": [{"kind": "disc", "center_mm": (0, 0), "radius_mm": 50}]},
}


def succeed(
    store: Store,
    claim: Claim | None = None,
    *,
    write: Callable[[Path], object] = lambda _: None,
    result: dict[str, Any] | None = None,
    **ended: Any,
) -> Claim:
    """Do a claimed job, or the next one, as a worker would, without any science."""
    claim = claim or store.jobs.claim("test")
    assert claim is not None
    output = store.files.make_attempt_folder(claim.job_id, claim.attempt)
    write(output)
    answer = answer_of(claim.job.kind, RESULTS[claim.job.kind]() if result is None else result)
    store.jobs.succeed(claim, answer, output, **ended)
    return claim


def write_answer(path: Path, result: CalibrationResult) -> None:
    """As the service's result.h5, without arrays."""
    about = result.model_dump(include={"software_version", "input_sha256"})
    write_calibration(path, result.model_dump(mode="json"), {}, **about)


def written_by_its_job(store: Store, path: Path) -> None:
    """Give the row of a result the digest of the file as a test has changed it."""
    store.jobs.note_digest_of_result(path, compute_digest(path))


def endless(path: Path) -> None:
    """Write a file of two texts, at which the library's reader does not end."""
    with h5py.File(path, "w") as file:
        file["texts"] = np.array(["alpha", "beta"], h5py.string_dtype())
    make_endless(path)


def make_endless(path: Path) -> None:
    """Give the first text in a file's heap a size of -16 bytes, which its reader never gets beyond."""
    content = bytearray(path.read_bytes())
    size = content.index(b"GCOL") + 24
    content[size : size + 8] = b"\xf0" + 7 * b"\xff"
    path.write_bytes(content)


def in_place_of(change: Callable[[h5py.File, str, tuple[int, ...], Path], None]) -> Callable[[Path, str], None]:
    """Take the values away from a file, and put something else there."""

    def damage(path: Path, values: str) -> None:
        with h5py.File(path, "r+") as file:
            shape = file[values].shape
            del file[values]
            change(file, values, shape, path)

    return damage


def external(file: h5py.File, values: str, shape: tuple[int, ...], path: Path) -> None:
    database = path.parents[2] / "sawmill.db"
    file.create_dataset(values, shape, np.float32, external=[(str(database), 0, 4 * int(np.prod(shape)))])


def virtual(file: h5py.File, values: str, shape: tuple[int, ...], _: Path) -> None:
    layout = h5py.VirtualLayout(shape, np.float32)
    layout[...] = h5py.VirtualSource("/elsewhere.h5", "data", shape)
    file.create_virtual_dataset(values, layout)


def linked(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file[values] = h5py.ExternalLink("/elsewhere.h5", "data")


def led_on(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file[values] = h5py.SoftLink("/entry")


def huge(file: h5py.File, values: str, _: tuple[int, ...], __: Path) -> None:
    file.create_dataset(values, (2, 30_000, 30_000), np.float32, chunks=(1, 30_000, 30_000), **PACKED, fletcher32=True)


def never_written(file: h5py.File, values: str, shape: tuple[int, ...], _: Path) -> None:
    file.create_dataset(values, shape, np.float32, chunks=(1, *shape[1:]), **PACKED, fletcher32=True)


def as_a_link(path: Path, _: str) -> None:
    path.rename(path.with_name("elsewhere.h5"))
    path.symlink_to(path.with_name("elsewhere.h5"))


def another_file(path: Path, _: str) -> None:
    path.write_bytes(b"another one")


def cut_off(path: Path, _: str) -> None:
    os.truncate(path, path.stat().st_size // 2)


DAMAGES: dict[str, Callable[[Path, str], None]] = {
    each.__name__: in_place_of(each) for each in (external, virtual, linked, led_on, huge, never_written)
} | {each.__name__: each for each in (as_a_link, another_file, cut_off)}
