"""Calibration with a scan, as jobs, commands and Python users ask for it."""

import math
from dataclasses import dataclass

import numpy as np

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.second_witness import with_second_witness, witness_of
from sawmill_calibration.checkpoints import NOTHING_KEPT, Keeper
from sawmill_calibration.scans.prepare import repeated
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.calibrations import (
    CalibrationLimits,
    CalibrationOptions,
    CalibrationResult,
    CalibrationSucceeded,
    Comparison,
)
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import StoredScanner
from sawmill_tomography.calibration.calibration import CalibratedGeometry, CalibrationOutcome
from sawmill_tomography.calibration.comparison import ChangeLimits, compare
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import Progress, ThetaBounds
from sawmill_vocabulary.calibration_arrays import CalibrationArrays


@dataclass(frozen=True, eq=False)
class CalibratedScan:
    """A calibration with its scan, whose rows the report reads."""

    scan: ScanRows
    calibration_input: CalibrationInput
    outcome: CalibrationOutcome

    def result(self, comparison: Comparison | None = None) -> CalibrationResult:
        """Return the answer; a comparison with the active calibration may add a reason."""
        witness = witness_of(self.outcome, self.calibration_input)
        return calibration_result(self.outcome, self.calibration_input, comparison, witness)

    def arrays(self, active: CalibratedGeometry | None = None) -> CalibrationArrays:
        """Compute the arrays of the report, with the log of other rows in the new and in the active geometry."""
        # Imported here because an answer without a report needs no reconstruction.
        from sawmill_calibration.calibration.calibration_files import (  # noqa: PLC0415
            calibration_arrays,
            find_log_row,
            log_images,
        )

        log = find_log_row(self.calibration_input, self.scan.usable_rows, self.scan.read_row)
        images = None if log is None else log_images(log, self.calibration_input, self.outcome.geometry, active)
        return calibration_arrays(self.outcome, self.calibration_input, images)


def calibrate_scan(
    scan: ScanRows,
    drawing: PhantomDrawing,
    options: CalibrationOptions,
    limits: CalibrationLimits,
    *,
    bounds: ThetaBounds | None = None,
    keeper: Keeper = NOTHING_KEPT,
) -> CalibratedScan:
    """Calibrate with the phantom's rows, and ask the log that other rows show as the second witness.

    Parameters
    ----------
    bounds : ThetaBounds, optional
        Expected ranges of theta, by which one of two equivalent thetas is reported.
    keeper : Keeper
        Keeps the progress of the published search, which is long.

    Raises
    ------
    ValueError
        The scan determines no geometry, or the options do not fit it: errors of `sawmill_tomography`, `InputError`.
    """
    stack = scan.stack()
    mean = mean_of_rows(stack)
    calibration_input = CalibrationInput(
        sinogram=mean.sinogram,
        angles_rad=scan.angles_rad[mean.views],
        rows=scan.rows,
        scanner=scan.scanner,
        bounds=bounds,
        drawing=drawing,
        input_sha256=scan.sha256,
        limits=limits,
        from_counts=scan.counts,
        views=mean.views,
        remarks=repeated(scan.remarks),
        saturated_share=scan.saturated_share,
    )
    calibration_input, outcome = run_calibration(
        calibration_input, options, scan.on_progress, stack=stack, rows_named=scan.rows_named, keeper=keeper
    )
    scan.on_progress(Progress(fraction=0.96, stage="log"))
    calibration_input, outcome = with_second_witness(
        outcome, calibration_input, row_range=options.log_rows, rows=scan.usable_rows, read=scan.read_row
    )
    return CalibratedScan(scan, calibration_input, outcome)


def geometry_of(result: CalibrationResult) -> CalibratedGeometry:
    """Return the geometry of a stored calibration."""
    return CalibratedGeometry(
        scanner=result.scanner,
        theta=result.theta,
        frame=result.source_frame,
        rotation=result.rotation,
        covariance=None if result.covariance is None else np.array(result.covariance),
    )


def compared(active: CalibrationSucceeded, new: CalibratedGeometry, scanner: StoredScanner) -> Comparison:
    """Compute what changed since the active calibration, by the scanner's constants and tolerances."""
    tolerances = scanner.tolerances
    radius_mm = scanner.log_radius_mm or active.radius_mm
    psi_rad = None if tolerances.angle_change_deg is None else math.radians(tolerances.angle_change_deg)
    limits = ChangeLimits(tolerances.ray_change_mm, psi_rad, radius_mm, tolerances.scale_percent)
    change = compare(scanner.constants, geometry_of(active), new, limits)
    return Comparison(
        coded_reason=CodedReason.of(change.reason),
        calibration_id=active.id,
        tolerance_mm=limits.ray_change_mm,
        angle_change_deg=math.degrees(change.psi_change_rad),
        tilt_change_deg=math.degrees(change.tilt_change_rad),
        **{name: value for name, value in vars(change).items() if name in Comparison.model_fields},
    )
