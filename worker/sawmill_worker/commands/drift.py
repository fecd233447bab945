"""`sawmill drift`: what moved since a calibration, or the COR from nominal distances, by a scan's file."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from sawmill_calibration.drift_checks.baselines import baselines_of, read_answers
from sawmill_calibration.drift_checks.drift_check import (
    DriftInput,
    mean_of_common_rows,
    run_drift,
)
from sawmill_calibration.drift_checks.given_geometry import GivenGeometry
from sawmill_calibration.scans.scan_rows import ScanRows, open_rows
from sawmill_calibration.scans.scan_source import ScanSource
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.drifts import DriftResult
from sawmill_vocabulary import Progress, ProgressCallback
from sawmill_worker.commands.calibrated_scan import open_with_calibration
from sawmill_worker.commands.geometry_options import CalibrationSource, ThetaSource


def check_drift(
    scan: ScanSource,
    geometry: ThetaSource | CalibrationSource,
    *,
    baseline: Sequence[Path] = (),
    tolerance_mm: float,
    on_progress: ProgressCallback,
) -> DriftResult:
    """Read, compare views, and compute the change from the geometry or from a baseline of earlier answers."""
    with _open(scan, geometry, on_progress) as (reference, used):
        baselines = baselines_of(read_answers(baseline), reference, used.sha256) if baseline else ()
        mean = mean_of_common_rows(used.stack(), used.rows[0], used.row_step, used.deviations)
    used.on_progress(Progress(fraction=0.0, stage="pair rays"))
    drift_input = DriftInput(
        mean=mean,
        angles_rad=used.angles_rad,
        rows=used.rows,
        calibration=reference,
        input_sha256=used.sha256,
        tolerance_mm=tolerance_mm,
        averaged_rows=scan.options.averaged_rows,
        preparation=used.remarks,
        baselines=baselines,
    )
    return run_drift(drift_input).ended(datetime.now(UTC))


@contextmanager
def _open(
    scan: ScanSource, geometry: ThetaSource | CalibrationSource, on_progress: ProgressCallback
) -> Iterator[tuple[CalibrationResult | GivenGeometry, ScanRows]]:
    if isinstance(geometry, ThetaSource):
        with open_rows(scan, source_to_cor_mm=geometry.source_to_cor_mm, on_progress=on_progress) as used:
            yield GivenGeometry(used.scanner, geometry.theta, geometry.rotation), used
        return
    with open_with_calibration(scan, geometry, on_progress=on_progress) as (reference, used):
        yield reference, used
