"""A calibration from a sinogram in memory: what the job and the command line share."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worker.contracts import calibrations as contracts
from worker.contracts.base import Handedness, Rotation
from worker.contracts.geometry import ScannerConstants, SourceFrameDeviation, ThetaBounds, ThetaDeviation
from worker.contracts.jobs import Progress
from worker.contracts.phantoms import PhantomDrawing
from worker.formats.result_files import write_calibration
from worker.pictures.calibration_report import calibration_report_png, overlay_png
from worker.tasks.conversion import from_frame, from_theta, to_bounds, to_phantom, to_scanner
from worker.tasks.report_table import report_table
from worker.tomography import geometry
from worker.tomography.calibration.calibration import Calibration
from worker.tomography.calibration.default import CalibrationTask, calibrate
from worker.tomography.calibration.paper import PaperOptions, calibrate_as_published
from worker.tomography.fbp import fbp
from worker.tomography.geometry import FanBeamGeometry, FloatArray, GeometryError
from worker.tomography.image_grid import ImageGrid
from worker.tomography.projector import Projector

Report = Callable[[Progress], None]
OVERLAY_SIZE = 512


@dataclass(frozen=True)
class CalibrationInput:
    """What is calibrated: a sinogram (views, detector) with each view's angle, and what is known of it."""

    sinogram: FloatArray
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    bounds: ThetaBounds | None
    drawing: PhantomDrawing
    input_sha256: str
    log_radius_mm: float = 150.0
    tolerance_mm: float = 0.1


def run_calibration(
    given: CalibrationInput, options: contracts.CalibrationOptions, report: Report
) -> tuple[Calibration, contracts.CalibrationResult]:
    """Calibrate by the method asked for; errors of `worker.tomography` pass through."""
    task = CalibrationTask(
        scanner=to_scanner(given.scanner),
        phantom=to_phantom(given.drawing),
        sinogram=given.sinogram,
        angles_rad=given.angles_rad,
        bounds=to_bounds(given.bounds),
        handedness=None if options.handedness is None else geometry.Handedness(options.handedness),
        rotation=None if options.rotation is None else geometry.Rotation(options.rotation),
        rays_per_cell=options.rays_per_cell,
        log_radius_mm=given.log_radius_mm,
        tolerance_mm=given.tolerance_mm,
    )

    def progress(generation: int, most: int, best: float) -> None:
        report(Progress(fraction=min(generation / most, 0.95), stage="search", generation=generation, best_value=best))

    if options.method is contracts.CalibrationMethod.PAPER:
        paper = PaperOptions(**options.paper.model_dump())
        calibration = calibrate_as_published(task, options=paper, seed=options.seed, progress=progress)
    else:
        calibration = calibrate(task, seed=options.seed, progress=progress)
    return calibration, calibration_result(calibration, given)


def calibration_result(calibration: Calibration, given: CalibrationInput) -> contracts.CalibrationResult:
    """The answer as it crosses a boundary."""
    predicted = calibration.predicted_ray_error
    return contracts.CalibrationResult(
        theta=from_theta(calibration.theta),
        theta_twin=None if calibration.theta_twin is None else from_theta(calibration.theta_twin),
        source_frame=from_frame(calibration.frame),
        standard_deviation=_deviation(calibration),
        covariance=None if calibration.covariance is None else calibration.covariance.tolist(),
        unconstrained_source_distance_mm=calibration.unconstrained_source_distance_mm,
        scale_uncertainty_mm=calibration.scale_uncertainty_mm,
        predicted_ray_error_mm=None
        if predicted is None
        else contracts.PredictedRayError(
            rms=predicted.rms_mm, max=predicted.max_mm, radius_mm=calibration.log_radius_mm
        ),
        handedness=Handedness(calibration.handedness),
        rotation=Rotation(calibration.rotation),
        hypotheses=[contracts.Hypothesis.model_validate(vars(report)) for report in calibration.hypotheses],
        phantom_position_mm=calibration.position_mm,
        gain=calibration.gain,
        offset=calibration.offset,
        residual=contracts.Residual(rms=calibration.residual_rms, relative=calibration.relative_residual),
        verdict=calibration.verdict,
        reasons=list(calibration.reasons),
        scanner=given.scanner,
        phantom=given.drawing.name,
        views=int(given.angles_rad.size),
        rows=given.rows,
        search=contracts.Search.model_validate(vars(calibration.search)),
        timing_s=contracts.Timing(**calibration.seconds),
        software_version=version("sawmill-calibration"),
        input_sha256=given.input_sha256,
    )


def _deviation(calibration: Calibration) -> contracts.StandardDeviation | None:
    frame = calibration.frame_deviation
    if frame is None:
        return None
    theta = calibration.theta_deviation
    names = list(SourceFrameDeviation.model_fields)
    return contracts.StandardDeviation(
        theta=ThetaDeviation.model_validate(
            dict.fromkeys(ThetaDeviation.model_fields)
            if theta is None
            else dict(zip(ThetaDeviation.model_fields, theta.tolist(), strict=True))
        ),
        source_frame=SourceFrameDeviation.model_validate(
            {name: value if value > 0.0 else None for name, value in zip(names, frame.tolist(), strict=True)}
        ),
    )


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


def write_report(
    folder: Path, calibration: Calibration, result: contracts.CalibrationResult, given: CalibrationInput
) -> None:
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


def write_report_png(
    path: Path, calibration: Calibration, result: contracts.CalibrationResult, given: CalibrationInput
) -> None:
    """Write the report's picture alone."""
    _write_report_png(path, phantom_image(calibration, given), calibration, result, given)


def _write_report_png(
    path: Path,
    drawn: PhantomImage,
    calibration: Calibration,
    result: contracts.CalibrationResult,
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
