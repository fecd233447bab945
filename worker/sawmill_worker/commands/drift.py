"""`sawmill drift`: a scan's file and a calibration to what moved."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from sawmill_worker.commands.options import CalibrationSource
from sawmill_worker.commands.reconstruct import open_with_calibration
from sawmill_worker.contracts.drifts import DriftResult
from sawmill_worker.use_cases.drift import DriftInput, mean_of_common_rows, run_drift
from sawmill_worker.use_cases.drift_baseline import baselines_of, read_answers
from sawmill_worker.use_cases.scan_source import ScanSource
from sawmill_worker.vocabulary import Progress, ProgressCallback


def check_drift(
    scan: ScanSource,
    calibration: CalibrationSource,
    *,
    baseline: Sequence[Path] = (),
    tolerance_mm: float,
    on_progress: ProgressCallback,
) -> DriftResult:
    """Read, compare views, and set the change against the calibration, or against a baseline of earlier answers."""
    with open_with_calibration(scan, calibration, on_progress=on_progress) as (known, used):
        baselines = baselines_of(read_answers(baseline), known, used.sha256)
        mean = mean_of_common_rows(used.stack(), used.rows[0], used.row_step, used.deviations)
    used.on_progress(Progress(fraction=0.0, stage="pair rays"))
    given = DriftInput(
        mean=mean,
        angles_rad=used.angles_rad,
        rows=used.rows,
        calibration=known,
        input_sha256=used.sha256,
        tolerance_mm=tolerance_mm,
        averaged_rows=scan.options.averaged_rows,
        preparation=used.remarks,
        baselines=baselines,
    )
    return run_drift(given).ended(datetime.now(UTC))
