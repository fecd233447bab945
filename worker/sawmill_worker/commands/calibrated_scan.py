"""A scan and a calibration of the same scanner, for the commands that need both."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sawmill_calibration.calibration.result_file import read_calibration
from sawmill_calibration.failures import refused
from sawmill_calibration.scans.scan_rows import ScanRows, open_rows
from sawmill_calibration.scans.scan_source import ScanSource
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.geometry import ScannerConstants
from sawmill_vocabulary import ProgressCallback
from sawmill_worker.commands.geometry_options import CalibrationSource


@contextmanager
def open_with_calibration(
    scan: ScanSource, geometry: CalibrationSource, *, on_progress: ProgressCallback, beside: Path | None = None
) -> Iterator[tuple[CalibrationResult, ScanRows]]:
    """Open a calibration and a scan of the same scanner; additional constants must agree with the calibration."""
    calibration, scan = _calibrated(scan, geometry)
    r_s = calibration.scanner.source_to_cor_mm
    with open_rows(scan, source_to_cor_mm=r_s, on_progress=on_progress, beside=beside) as used:
        _check_same_detector(calibration.scanner, used.scanner)
        yield calibration, used


def _calibrated(scan: ScanSource, geometry: CalibrationSource) -> tuple[CalibrationResult, ScanSource]:
    """Return the calibration, and the scan with the detector pitch of the calibration."""
    calibration = read_calibration(geometry.path)
    r_s, pitch = calibration.scanner.source_to_cor_mm, calibration.scanner.detector_pitch_mm
    _check_agreement("source_to_cor_mm", r_s, geometry.source_to_cor_mm)
    _check_agreement("detector_pitch_mm", pitch, scan.options.detector_pitch_mm)
    return calibration, replace(scan, options=scan.options.model_copy(update={"detector_pitch_mm": pitch}))


def _check_agreement(name: str, carried: float, flag: float | None) -> None:
    if flag is not None and not math.isclose(flag, carried, rel_tol=1e-6):
        raise refused(
            "contradiction", f"the calibration carries {name} {carried:.9g} and {flag:.9g} was given; correct one"
        )


def _check_same_detector(of_calibration: ScannerConstants, of_scan: ScannerConstants) -> None:
    calibrated, cells = of_calibration.num_detector_pixels, of_scan.num_detector_pixels
    if calibrated != cells:
        raise refused(
            "contradiction",
            f"the calibration is of a detector of {calibrated} cells and the scan has {cells}: "
            "use the calibration of the same scanner",
        )
