"""Calibration with a scan, as jobs, commands and Python users ask for it."""

from dataclasses import dataclass

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.calibration.second_witness import with_second_witness, witness_of
from sawmill_calibration.checkpoints import NOTHING_KEPT, Keeper
from sawmill_calibration.scans.prepare import repeated
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.calibrations import CalibrationLimits, CalibrationOptions, CalibrationResult, Comparison
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_tomography.calibration.calibration import CalibratedGeometry, CalibrationOutcome
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
        from sawmill_calibration.calibration.calibration_files import calibration_arrays  # noqa: PLC0415
        from sawmill_calibration.calibration.log_comparison import find_log_row, log_images  # noqa: PLC0415

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
