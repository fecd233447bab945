"""File of a calibration: the answer, the report's arrays, and a log with the new and with the previous geometry."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.calibration.calibrate import CalibrationInput
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_formats.output.calibration_file import NamedArray, write_calibration
from sawmill_tomography.calibration.calibration import CalibratedGeometry, CalibrationOutcome
from sawmill_tomography.calibration.phantom_rows import shows_another_body
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.present_rows import filled
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, ReconstructionMethod
from sawmill_vocabulary.calibration_arrays import CalibrationArrays, LogBefore, LogImages

PHANTOM_SIZE = 256
# Regularisation weight of the image of a phantom with views over less than a full turn: as smooth as with the weight
# that cross-validation chooses for the measured disc (docs/understand/measured.md), in a tenth of the time.
MOST_VIEWS, WEIGHT, ITERATIONS = 60, 200.0, 60


def calibration_arrays(
    calibration: CalibrationOutcome, calibration_input: CalibrationInput, log: LogImages | None
) -> CalibrationArrays:
    """Compute the arrays from which a calibration's pictures are drawn, as docs/look-up/formats.md lists them."""
    outlines, gap = calibration.seen.outlines(), np.full((1, 2), np.nan)
    closed = [piece for outline in outlines for piece in (gap, outline, outline[:1])]
    reach = max(float(np.abs(outline).max()) for outline in outlines)
    frame = calibration.frame
    field = min(2.4 * reach, 1.3 * frame.source_distance_mm * math.cos(frame.tilt_rad))
    image, method = _phantom_image(calibration, calibration_input, field)
    return CalibrationArrays(
        sinogram=calibration_input.sinogram.astype(np.float32),
        model=calibration.model.astype(np.float32),
        residual=calibration.residual.astype(np.float32),
        angles_rad=calibration_input.angles_rad,
        phantom_image=image,
        phantom_field_mm=field,
        phantom_outlines_mm=np.concatenate(closed[1:]),
        search_history=np.array(calibration.search.history, np.float64).reshape(-1, 2),
        phantom_image_method=method,
        log=log,
    )


def write_result(folder: Path, result: CalibrationResult, arrays: CalibrationArrays, *, log_unit: str) -> None:
    """Write result.h5 into the folder; `log_unit` is the unit of the log's images."""
    named = {
        "sinogram": NamedArray(arrays.sinogram, "as given", "view, detector"),
        "model": NamedArray(arrays.model, "as given", "view, detector"),
        "residual": NamedArray(arrays.residual, "as given", "view, detector"),
        "angles_rad": NamedArray(arrays.angles_rad, "rad", "view"),
        "phantom_image": NamedArray(arrays.phantom_image, "1", "x, y"),
        "phantom_field_mm": NamedArray(np.array(arrays.phantom_field_mm), "mm", "side of phantom_image"),
        "phantom_image_method": NamedArray(np.array(arrays.phantom_image_method.encode("ascii")), "1", "method's name"),
        "phantom_outlines_mm": NamedArray(arrays.phantom_outlines_mm, "mm", "point, (x, y)"),
        "search_history": NamedArray(arrays.search_history, "1", "step, (evaluations, best value)"),
    }
    if arrays.log is not None:
        named |= _log_arrays(arrays.log, log_unit)
    write_calibration(
        folder / "result.h5",
        result.model_dump(mode="json"),
        named,
        software_version=result.software_version,
        input_sha256=result.input_sha256,
    )


def _phantom_image(
    calibration: CalibrationOutcome, calibration_input: CalibrationInput, field_mm: float
) -> tuple[NDArray[np.float32], ReconstructionMethod]:
    """Reconstruct the phantom in units of the drawing's density: FBP, or total variation for less than a full turn."""
    fan = FanBeamGeometry(
        calibration.scanner, calibration.theta, calibration.rotation.apply(calibration_input.angles_rad)
    )
    projector = Projector(fan, ImageGrid(PHANTOM_SIZE, field_mm))
    fit = calibration.findings.fit
    lines = (calibration_input.sinogram - fit.offset) / fit.gain
    try:
        return fbp(projector, lines).image, ReconstructionMethod.FBP
    except GeometryError:  # the views cover less than a full turn
        # Imported here because few scans need it.
        from sawmill_tomography.reconstruction.total_variation import total_variation  # noqa: PLC0415

        few = slice(None, None, max(1, fan.angles_rad.size // MOST_VIEWS))
        coarse = Projector(fan.at(few), projector.grid)
        image = total_variation(coarse, lines[few], weight=WEIGHT, iterations=ITERATIONS).image
        return image, ReconstructionMethod.TOTAL_VARIATION


def _log_arrays(log: LogImages, unit: str) -> dict[str, NamedArray]:
    arrays = {
        "log_row": NamedArray(np.array(log.row), "1", "row of the scan"),
        "log_field_mm": NamedArray(np.array(log.field_mm), "mm", "side of log_after and log_before"),
        "log_after": NamedArray(log.after, unit, "x, y"),
    }
    if log.before is not None:
        arrays["log_before"] = NamedArray(log.before, unit, "x, y")
        arrays["log_before_with"] = NamedArray(np.array(log.before_with.encode("ascii")), "1", "geometry's name")
    return arrays


SIZE = 256
# Field larger than the largest log's radius, so that the bark is seen to be round.
MARGIN = 1.15


@dataclass(frozen=True)
class LogRow:
    """A row of the scan outside the phantom's rows that shows a log: its number and sinogram (views, detector)."""

    row: int
    sinogram: FloatArray


def find_log_row(
    calibration_input: CalibrationInput, rows: tuple[int, int], read: Callable[[int], NDArray[np.float32]]
) -> LogRow | None:
    """Return the middle of the longer run of `rows` outside the phantom's, read by number, if it shows a log."""
    first, after_last = max(
        (rows[0], calibration_input.rows[0]), (calibration_input.rows[1], rows[1]), key=lambda run: run[1] - run[0]
    )
    if after_last <= first:
        return None
    row = (first + after_last) // 2
    sinogram = filled(calibration_input.of_views(read(row))[:, None], calibration_input.angles_rad)[:, 0].astype(
        np.float64
    )
    return LogRow(row, sinogram) if shows_another_body(sinogram, calibration_input.sinogram) else None


def log_images(
    log: LogRow,
    calibration_input: CalibrationInput,
    new_geometry: CalibratedGeometry,
    active: CalibratedGeometry | None,
) -> LogImages | None:
    """Reconstruct the log with the new geometry, and the active or an unshifted one; None for less than a turn."""
    field = 2.0 * MARGIN * (calibration_input.limits.log_radius_mm or LARGEST_ASSUMED_LOG_RADIUS_MM)
    after = _image(log, calibration_input, new_geometry, field)
    if after is None:
        return None
    comparable = (
        active is not None and active.scanner.num_detector_pixels == calibration_input.scanner.num_detector_pixels
    )
    if active is not None and comparable:
        return LogImages(log.row, field, after, _image(log, calibration_input, active, field), LogBefore.ACTIVE)
    return LogImages(
        log.row, field, after, _image(log, calibration_input, unshifted(new_geometry), field), LogBefore.UNSHIFTED
    )


def unshifted(new_geometry: CalibratedGeometry) -> CalibratedGeometry:
    """Return the geometry without shifts and tilt; no constant holds the new distance and first angle, which stay."""
    theta = Theta(new_geometry.frame.psi_rad, new_geometry.theta.detector_to_cor_mm, 0.0, 0.0, 0.0)
    frame = theta.source_frame(new_geometry.scanner.source_to_cor_mm)
    return replace(new_geometry, theta=theta, frame=frame, covariance=None)


def _image(
    log: LogRow, calibration_input: CalibrationInput, geometry: CalibratedGeometry, field_mm: float
) -> NDArray[np.float32] | None:
    angles = geometry.rotation.apply(calibration_input.angles_rad)
    try:
        fan = FanBeamGeometry(geometry.scanner, geometry.theta, angles)
        return fbp(Projector(fan, ImageGrid(SIZE, field_mm)), log.sinogram).image
    except GeometryError:
        return None
