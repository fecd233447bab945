"""What a calibration leaves behind: its HDF5, and the report that is drawn from the same answer and arrays."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.calibrations import CalibrationResult
from sawmill_worker.files.calibration_file import NamedArray, write_calibration
from sawmill_worker.tomography.calibration.calibration import Calibration
from sawmill_worker.tomography.fbp import fbp
from sawmill_worker.tomography.geometry import FanBeamGeometry, GeometryError
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.phantom import Phantom
from sawmill_worker.tomography.projector import Projector
from sawmill_worker.use_cases.calibrate import CalibrationInput
from sawmill_worker.use_cases.log_comparison import LogImages

PHANTOM_SIZE = 256


def calibration_arrays(
    calibration: Calibration, given: CalibrationInput, log: LogImages | None
) -> dict[str, NamedArray]:
    """The arrays behind a calibration's pictures, as docs/formats.md lists them."""
    seen = calibration.seen
    reach = max(float(np.abs(outline).max()) for outline in seen.outlines())
    field = min(2.4 * reach, 1.3 * calibration.frame.source_distance_mm)
    arrays = {
        "sinogram": NamedArray(given.sinogram.astype(np.float32), "as given", "view, detector"),
        "model": NamedArray(calibration.model.astype(np.float32), "as given", "view, detector"),
        "residual": NamedArray(calibration.residual.astype(np.float32), "as given", "view, detector"),
        "angles_rad": NamedArray(given.angles_rad, "rad", "view"),
        "phantom_image": NamedArray(_phantom_image(calibration, given, field), "1", "x, y"),
        "phantom_field_mm": NamedArray(np.array(field), "mm", "side of phantom_image"),
        "phantom_outlines_mm": NamedArray(_closed(seen), "mm", "point, (x, y)"),
        "search_history": NamedArray(
            np.array(calibration.search.history, np.float64).reshape(-1, 2), "1", "step, (evaluations, best value)"
        ),
    }
    return arrays if log is None else {**arrays, **_log_arrays(log)}


def write_result(folder: Path, result: CalibrationResult, arrays: dict[str, NamedArray]) -> None:
    """Write result.h5 into the folder."""
    write_calibration(
        folder / "result.h5",
        result.model_dump(mode="json"),
        arrays,
        software_version=result.software_version,
        input_sha256=result.input_sha256,
    )


def write_report_png(path: Path, result: CalibrationResult, arrays: dict[str, NamedArray]) -> None:
    """Write the report's picture."""
    # Drawing takes longer to import than a calibration takes.
    from sawmill_worker.pictures.calibration_report import report_png  # noqa: PLC0415

    values: dict[str, NDArray[Any]] = {name: array.values for name, array in arrays.items()}
    path.write_bytes(report_png(result.model_dump(mode="json"), values))


def _phantom_image(calibration: Calibration, given: CalibrationInput, field_mm: float) -> NDArray[np.float32]:
    """The phantom in units of its drawing's density; all zero where the views do not go all round."""
    angles = calibration.rotation.apply(given.angles_rad)
    try:
        fan = FanBeamGeometry(calibration.scanner, calibration.theta, angles)
        projector = Projector(fan, ImageGrid(PHANTOM_SIZE, field_mm))
        return fbp(projector, (given.sinogram - calibration.offset) / calibration.gain).image
    except GeometryError:
        return np.zeros((PHANTOM_SIZE, PHANTOM_SIZE), np.float32)


def _closed(phantom: Phantom) -> NDArray[np.float64]:
    """All outlines one after the other, each closed, NaN between two of them."""
    gap = np.full((1, 2), np.nan)
    pieces = [piece for outline in phantom.outlines() for piece in (gap, outline, outline[:1])]
    return np.concatenate(pieces[1:])


def _log_arrays(log: LogImages) -> dict[str, NamedArray]:
    arrays = {
        "log_row": NamedArray(np.array(log.row), "1", "row of the scan"),
        "log_field_mm": NamedArray(np.array(log.field_mm), "mm", "side of log_after and log_before"),
        "log_after": NamedArray(log.after, log.unit, "x, y"),
    }
    if log.before is not None:
        arrays["log_before"] = NamedArray(log.before, log.unit, "x, y")
    return arrays
