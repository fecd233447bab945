"""`sawmill drift`: a scan's file and a calibration to what moved."""

from dataclasses import replace

import numpy as np

from sawmill_worker.commands.options import CalibrationSaid, ScanSaid
from sawmill_worker.commands.reconstruct import open_with_calibration
from sawmill_worker.contracts.drifts import DriftResult
from sawmill_worker.use_cases.drift import DriftInput, run_drift
from sawmill_worker.vocabulary import Progress, ProgressCallback


def look_for_drift(
    said: ScanSaid, calibration: CalibrationSaid, *, tolerance_mm: float, report: ProgressCallback
) -> DriftResult:
    """Read, pair opposite rays, compare."""
    with open_with_calibration(said, calibration, report=report) as (known, used):
        sinogram = used.stack().mean(axis=1, dtype=np.float64)
    used.report(Progress(fraction=0.0, stage="pair rays"))
    given = DriftInput(
        sinogram=sinogram,
        angles_rad=used.angles_rad,
        rows=used.rows,
        calibration=known,
        input_sha256=used.sha256,
        tolerance_mm=tolerance_mm,
    )
    if known.predicted_ray_error_mm is not None:
        given = replace(given, log_radius_mm=known.predicted_ray_error_mm.radius_mm)
    return run_drift(given)
