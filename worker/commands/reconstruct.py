"""`sawmill reconstruct`: a scan's file and a geometry to a volume."""

import math
from dataclasses import replace
from pathlib import Path

from worker.commands.options import CalibrationSaid, ScanSaid, ThetaSaid
from worker.commands.result_file import read_calibration
from worker.commands.scan_input import ScanInput, load
from worker.commands.terminal import Report
from worker.contracts.base import Handedness, Rotation
from worker.contracts.calibrations import CalibrationResult
from worker.contracts.geometry import Theta
from worker.contracts.jobs import Progress
from worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from worker.pictures.images import image_png
from worker.tasks.failures import refused
from worker.tasks.reconstructing import ReconstructionInput, run_reconstruction, volume_unit
from worker.tasks.writing_volumes import write_volume


def reconstruct_scan(
    said: ScanSaid,
    geometry: ThetaSaid | CalibrationSaid,
    options: ReconstructionOptions,
    *,
    output: Path,
    picture: Path | None,
    report: Report,
) -> ReconstructionResult:
    """Read, reconstruct each row, write the volume, and a picture of its middle slice where one is asked for."""
    report(Progress(fraction=0.0, stage="read"))
    given = _with_theta(said, geometry) if isinstance(geometry, ThetaSaid) else _with_calibration(said, geometry)
    volume, result = run_reconstruction(given, options, report)
    write_volume(output, volume, result, options, given.scanner)
    if picture is not None:
        middle = len(volume) // 2
        title = f"{said.path.name}, slice {middle}"
        picture.write_bytes(image_png(volume[middle], pixel_mm=result.pixel_mm, unit=result.unit, title=title))
    return result


def _with_theta(said: ScanSaid, geometry: ThetaSaid) -> ReconstructionInput:
    used = load(said, source_to_cor_mm=geometry.source_to_cor_mm)
    return _input(used, geometry.theta, geometry.rotation, Handedness.AS_DRAWN)


def _with_calibration(said: ScanSaid, geometry: CalibrationSaid) -> ReconstructionInput:
    known, used = load_with_calibration(said, geometry)
    return _input(used, known.theta, known.rotation, known.handedness)


def load_with_calibration(said: ScanSaid, geometry: CalibrationSaid) -> tuple[CalibrationResult, ScanInput]:
    """A calibration and a scan of the same scanner; what is said beside the calibration must agree with it."""
    known = read_calibration(geometry.path)
    r_s, pitch = known.scanner.source_to_cor_mm, known.scanner.detector_pitch_mm
    _check_agreement("source_to_cor_mm", r_s, geometry.source_to_cor_mm)
    _check_agreement("detector_pitch_mm", pitch, said.detector_pitch_mm)
    used = load(replace(said, detector_pitch_mm=pitch), source_to_cor_mm=r_s)
    _check_same_detector(known, used)
    return known, used


def _input(used: ScanInput, theta: Theta, rotation: Rotation, handedness: Handedness) -> ReconstructionInput:
    return ReconstructionInput(
        line_integrals=used.stack,
        angles_rad=used.angles_rad,
        rows=used.rows,
        scanner=used.scanner,
        theta=theta,
        rotation=rotation,
        handedness=handedness,
        input_sha256=used.sha256,
        unit=volume_unit(counts=used.counts),
    )


def _check_agreement(name: str, carried: float, flag: float | None) -> None:
    if flag is not None and not math.isclose(flag, carried, rel_tol=1e-6):
        raise refused(
            "contradiction", f"the calibration says {name} {carried:.9g} and {flag:.9g} was given; correct one"
        )


def _check_same_detector(known: CalibrationResult, used: ScanInput) -> None:
    calibrated, cells = known.scanner.num_detector_pixels, used.scanner.num_detector_pixels
    if calibrated != cells:
        raise refused(
            "contradiction",
            f"the calibration is of a detector of {calibrated} cells and the scan has {cells}: "
            "use the calibration of the same scanner",
        )
