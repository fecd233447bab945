"""A log in the same scan as the phantom, reconstructed with the new and with the previous geometry."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.calibration.calibrate import CalibrationInput
from sawmill_tomography.calibration.calibration import CalibratedGeometry
from sawmill_tomography.calibration.phantom_rows import shows_another_body
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, GeometryError, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_tomography.sinograms.present_rows import filled
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM
from sawmill_vocabulary.calibration_arrays import LogBefore, LogImages

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
