"""The files that a calibration leaves behind: its pictures and its HDF5."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worker.contracts.calibrations import CalibrationResult
from worker.formats.result_files import write_calibration
from worker.pictures.calibration_report import calibration_report_png, overlay_png
from worker.tasks.calibrating import CalibrationInput
from worker.tasks.report_table import report_table
from worker.tomography.calibration.calibration import Calibration
from worker.tomography.fbp import fbp
from worker.tomography.geometry import FanBeamGeometry, GeometryError
from worker.tomography.image_grid import ImageGrid
from worker.tomography.projector import Projector

OVERLAY_SIZE = 512


@dataclass(frozen=True)
class PhantomImage:
    """The phantom reconstructed with the geometry found: image (x, y) in units of its drawing's density."""

    image: NDArray[np.float32]
    field_mm: float
    remark: str = ""


def phantom_image(calibration: Calibration, given: CalibrationInput) -> PhantomImage:
    """Reconstruct the phantom; a partial turn calibrates but has no image, which the remark says."""
    reach = max(float(np.abs(outline).max()) for outline in calibration.seen.outlines())
    field = min(2.4 * reach, 1.3 * calibration.frame.source_distance_mm)
    angles = calibration.rotation.apply(given.angles_rad)
    try:
        fan = FanBeamGeometry(calibration.scanner, calibration.theta, angles)
        projector = Projector(fan, ImageGrid(OVERLAY_SIZE, field))
        return PhantomImage(fbp(projector, (given.sinogram - calibration.offset) / calibration.gain), field)
    except GeometryError:
        blank = np.zeros((OVERLAY_SIZE, OVERLAY_SIZE), np.float32)
        return PhantomImage(blank, field, " (no image: the views do not go all round)")


def write_report(folder: Path, calibration: Calibration, result: CalibrationResult, given: CalibrationInput) -> None:
    """Write report.png, overlay.png and result.h5 into the folder."""
    drawn = phantom_image(calibration, given)
    _write_report_png(folder / "report.png", drawn, calibration, result, given)
    overlay = overlay_png(
        image=drawn.image,
        field_mm=drawn.field_mm,
        outlines=calibration.seen.outlines(),
        title=f"{given.drawing.name} with the geometry found{drawn.remark}",
    )
    (folder / "overlay.png").write_bytes(overlay)
    unit = "as given"
    write_calibration(
        folder / "result.h5",
        result.model_dump(mode="json"),
        {
            "sinogram": (given.sinogram.astype(np.float32), unit, "view, detector"),
            "model": (calibration.model.astype(np.float32), unit, "view, detector"),
            "residual": (calibration.residual.astype(np.float32), unit, "view, detector"),
            "angles_rad": (given.angles_rad, "rad", "view"),
            "phantom_image": (drawn.image, "1", f"x, y; field {drawn.field_mm:.6g} mm"),
        },
        software_version=result.software_version,
        input_sha256=result.input_sha256,
    )


def write_report_png(path: Path, calibration: Calibration, result: CalibrationResult, given: CalibrationInput) -> None:
    """Write the report's picture alone."""
    _write_report_png(path, phantom_image(calibration, given), calibration, result, given)


def _write_report_png(
    path: Path,
    drawn: PhantomImage,
    calibration: Calibration,
    result: CalibrationResult,
    given: CalibrationInput,
) -> None:
    report = calibration_report_png(
        image=drawn.image,
        field_mm=drawn.field_mm,
        outlines=calibration.seen.outlines(),
        sinogram=given.sinogram,
        residual=calibration.residual,
        angles_deg=np.rad2deg(given.angles_rad),
        pitch_mm=given.scanner.detector_pitch_mm,
        table=report_table(result),
        verdict=result.verdict,
        title=f"Calibration with {given.drawing.name}{drawn.remark}",
    )
    path.write_bytes(report)
