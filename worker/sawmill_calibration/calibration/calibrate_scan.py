"""Calibration with a scan, as jobs, commands and Python users ask for it.

The log in the scan of a phantom tests the calibration, in the rows that show it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.calibration.calibrate import CalibrationInput, calibration_result, run_calibration
from sawmill_calibration.checkpoints import NOTHING_KEPT, Keeper
from sawmill_calibration.failures import refused
from sawmill_calibration.scans.prepare import repeated
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts import calibrations as contracts
from sawmill_contracts.calibrations import (
    CalibrationLimits,
    CalibrationOptions,
    CalibrationResult,
    CalibrationSucceeded,
    Comparison,
)
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scanners import StoredScanner
from sawmill_tomography.calibration.calibration import CalibratedGeometry, CalibrationOutcome
from sawmill_tomography.calibration.comparison import ChangeLimits, compare
from sawmill_tomography.calibration.judgement import Evidence
from sawmill_tomography.calibration.phantom_rows import shows_another_body
from sawmill_tomography.calibration.second_witness import LogWitness
from sawmill_tomography.drift.change import DriftError
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import FEWEST_PAIRED_VIEWS, Progress, ThetaBounds
from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_vocabulary.scan_messages import AdjustmentMessage

# Number of averaged rows, evenly spaced over the possible rows; a row next to the phantom's rows may show both.
MOST_ROWS, GAP = 16, 1
# Rows of the log are distinguished from the phantom's rows by means over blocks of views and cells, which suppress
# noise. A block has up to BLOCK_VIEWS views, or fewer where the views would turn too far to be similar.
BLOCK_VIEWS, BLOCK_CELLS, BLOCKS_A_TURN = 6, 8, 20


@dataclass(frozen=True)
class LogRows:
    """Mean (views, detector) of rows that show a log, and the row numbers."""

    rows: tuple[int, ...]
    sinogram: FloatArray


def with_second_witness(
    calibration: CalibrationOutcome,
    calibration_input: CalibrationInput,
    *,
    row_range: str | None,
    rows: tuple[int, int],
    read: Callable[[int], NDArray[np.float32]],
) -> tuple[CalibrationInput, CalibrationOutcome]:
    """Add the log in the rows A:B of the scan, or else where it is found, to the calibration as second witness.

    `read` returns (views, detector) of any of the `rows`. The input gets a remark if a log could not be used.
    """
    if calibration.findings.error_bars is None or calibration_input.angles_rad.size < FEWEST_PAIRED_VIEWS:
        return calibration_input, calibration
    log = log_rows(calibration_input, row_range=row_range, rows=rows, read=read)
    if log is None:
        return calibration_input, calibration
    # Imported here because the module imports the reconstruction, which a scan without a log does not need.
    from sawmill_tomography.calibration.with_log import with_log  # noqa: PLC0415

    try:
        combined = with_log(calibration, log.sinogram)
    except DriftError as error:
        remark = AdjustmentMessage.LOG_NOT_USED(rows=f"{log.rows[0]}:{log.rows[-1] + 1}", why=str(error))
        return calibration_input.with_remark(remark), calibration
    return replace(calibration_input, log_rows=log.rows), combined


def log_rows(
    calibration_input: CalibrationInput,
    *,
    row_range: str | None,
    rows: tuple[int, int],
    read: Callable[[int], NDArray[np.float32]],
) -> LogRows | None:
    """Return the given rows, or those outside the phantom's that show another body in all views; None without any."""
    phantom_rows = calibration_input.rows
    outside = [*range(rows[0], phantom_rows[0] - GAP), *range(phantom_rows[1] + GAP, rows[1])]
    candidates = outside if row_range is None else _requested(phantom_rows, row_range, rows)
    spaced = np.unique(np.linspace(0, len(candidates) - 1, MOST_ROWS).astype(int))
    tried = [candidates[index] for index in spaced] if candidates else []
    phantom = _coarse(calibration_input.sinogram)
    lines = ((row, calibration_input.of_views(read(row)).astype(np.float64)) for row in tried)
    shown = {row: sinogram for row, sinogram in lines if shows_another_body(_coarse(sinogram), phantom)}
    if row_range is not None and not shown:
        raise refused("log-not-found", f"rows {row_range} of the scan show no log: give rows that do, or leave it out")
    return LogRows(tuple(shown), np.mean(list(shown.values()), axis=0)) if shown else None


def witness_of(calibration: CalibrationOutcome, calibration_input: CalibrationInput) -> contracts.LogCheck | None:
    """Convert the answers of phantom and log to the contract."""
    if not isinstance(calibration.findings, Evidence) or calibration.findings.witness is None:
        return None
    witness = calibration.findings.witness
    jump = witness.log.movement
    return contracts.LogCheck(
        log_rows=(calibration_input.log_rows[0], calibration_input.log_rows[-1] + 1),
        log_rows_averaged=len(calibration_input.log_rows),
        log=_pair(witness.log.detector.values),
        log_standard_deviation=_pair(witness.log.detector.deviations),
        phantom=_pair(witness.phantom.values),
        phantom_standard_deviation=_pair(witness.phantom.deviations),
        difference=_pair(witness.difference.values),
        difference_standard_deviation=_pair(witness.difference.deviations),
        reported=_pair(witness.reported.values),
        reported_standard_deviation=_pair(witness.reported.deviations),
        chi_squared=witness.chi_squared,
        ray_change_mm=witness.ray_change_mm,
        agreement=witness.agreement,
        moved=witness.moved,
        used=witness.taken,
        log_jump_mm=None if jump is None else jump.by_mm,
        log_jump_view=None if jump is None else jump.view,
        reason=_reason(witness),
    )


def _reason(witness: LogWitness) -> str:
    statistic = f"chi-squared {witness.chi_squared:.1f} of 2 degrees of freedom"
    if witness.other_sense:
        return "the log turned the other way than the phantom is explained by: its answer was not used"
    jump = witness.log.movement
    match witness.taken:
        case "log" if jump is None:
            return f"the phantom slipped and the log contradicts it ({statistic}): the log's u_c and tilt were taken"
        case "log":
            return f"the log stood still and contradicts the phantom ({statistic}): its u_c and tilt were taken"
        case "phantom" if jump is None:
            return (
                f"the log contradicts the phantom ({statistic}), so few views do not tell why: the phantom's were taken"
            )
        case "phantom" if jump is not None:
            return f"the log moved by {jump.by_mm:.2g} mm at view {jump.view}: the phantom's u_c and tilt were taken"
    return f"both agree ({statistic}): they were combined by their covariances"


def _requested(phantom_rows: tuple[int, int], row_range: str, rows: tuple[int, int]) -> list[int]:
    chosen, (first, after_last) = parse_rows(row_range), phantom_rows
    if chosen.start < rows[0] or chosen.stop > rows[1]:
        raise refused("rows-outside", f"log rows {row_range} were asked for, but the scan has rows {rows[0]}:{rows[1]}")
    if chosen.start < after_last and first < chosen.stop:
        raise refused(
            "rows-overlap",
            f"log rows {row_range} overlap the phantom's rows {first}:{after_last}: give rows beside them",
        )
    return list(range(chosen.start, chosen.stop))


def _coarse(sinogram: FloatArray) -> FloatArray:
    """Compute means over blocks of views and cells, (blocks,)."""
    together = min(BLOCK_VIEWS, max(1, len(sinogram) // BLOCKS_A_TURN))
    views, cells = (size // block * block for size, block in zip(sinogram.shape, (together, BLOCK_CELLS), strict=True))
    blocks = sinogram[:views, :cells].reshape(views // together, together, -1, BLOCK_CELLS)
    return np.asarray(blocks.mean(axis=(1, 3)).ravel())


def _pair(values: tuple[float, float]) -> contracts.ColumnAndTilt:
    column, tilt = values
    return contracts.ColumnAndTilt(cor_column_mm=column, tilt_rad=tilt)


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
