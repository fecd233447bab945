"""Calibration from a sinogram in memory, and its answer as a contract."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.checkpoints import NOTHING_KEPT, Keeper
from sawmill_calibration.known_geometry import from_deviation, from_predicted, to_phantom
from sawmill_contracts import calibrations as contracts
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.reasons import CodedReason
from sawmill_tomography.calibration.calibrate import calibrate
from sawmill_tomography.calibration.calibration import CalibrationOutcome
from sawmill_tomography.calibration.phantom_rows import odd_rows, segments
from sawmill_tomography.calibration.recalling import Evaluations, RecallingObjective
from sawmill_tomography.calibration.refusals import CalibrationError
from sawmill_tomography.calibration.search.search import SearchCallback
from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.calibration.uncertainty_budget import uncertainty_budget
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.sinograms.present_rows import mean_of_rows
from sawmill_vocabulary import Adjustment, CalibrationMethod, Progress, ProgressCallback, ThetaBounds
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.messages import Reason, Value
from sawmill_vocabulary.scan_messages import AdjustmentMessage
from sawmill_vocabulary.version import VERSION

# Number of runs of rows that are tried, longest first: a phantom covers more rows than a saw's kerf.
MOST_RUNS = 8
# Fractions of the progress at which the search for the phantom's rows and the search for the geometry end.
ROWS_DONE, SEARCH_DONE = 0.5, 0.95
# Interval between reports of search steps, s; number of steps that fill half of the remaining progress.
STEPS_EVERY_S, MANY_STEPS = 1.0, 1000
# A drawing contradicts a measurement if the two differ by more than this number of standard uncertainties.
CONTRADICTION = 3.0
AXES = {"x": 0, "y": 1}


@dataclass(frozen=True)
class CalibrationInput:
    """Mean sinogram (views, detector), each view's angle, and what is known; `views` are numbers among all read."""

    sinogram: FloatArray
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    bounds: ThetaBounds | None
    drawing: PhantomDrawing
    input_sha256: str
    limits: contracts.CalibrationLimits = field(default_factory=contracts.CalibrationLimits)
    from_counts: bool = False
    remarks: tuple[str, ...] = ()
    views: NDArray[np.intp] | None = None
    log_rows: tuple[int, ...] = ()
    saturated_share: float = 0.0

    def of_views(self, read: NDArray[np.float32]) -> NDArray[np.float32]:
        """Select the sinogram's views from an array over all views that were read, (views, ...)."""
        return read if self.views is None else read[self.views]

    def of_rows(self, stack: NDArray[np.float32], rows: tuple[int, int]) -> "CalibrationInput":
        """Narrow the input, with a remark, to rows of its stack (views, rows, detector) with the sinogram's views."""
        first, last = rows
        remark = AdjustmentMessage.PHANTOM_ROWS(rows="{}:{}".format(*self.rows), used=f"{first}:{last}")
        mean = mean_of_rows(stack[:, first - self.rows[0] : last - self.rows[0]])
        views = mean.views if self.views is None else self.views[mean.views]
        narrowed = replace(self, sinogram=mean.sinogram, angles_rad=self.angles_rad[mean.views], rows=rows, views=views)
        return narrowed.with_remark(remark)

    def with_remark(self, remark: str) -> "CalibrationInput":
        """Add a remark."""
        return replace(self, remarks=(*self.remarks, remark))


def run_calibration(
    calibration_input: CalibrationInput,
    options: contracts.CalibrationOptions,
    on_progress: ProgressCallback,
    *,
    stack: NDArray[np.float32] | None = None,
    rows_named: bool = False,
    keeper: Keeper = NOTHING_KEPT,
) -> tuple[CalibrationInput, CalibrationOutcome]:
    """Calibrate by the requested method; return the input too, narrowed to the phantom's rows where these were found.

    The stack (views, rows, detector) float32 has the input's rows: unless they were named, the phantom's are found.
    """
    if rows_named and stack is not None:
        calibration_input, stack = _with_odd_rows(calibration_input, stack), None
    if Adjustment.PHANTOM_ROWS in options.without:
        stack = None
    reporting = SearchProgress(on_progress, 0.0 if stack is None else ROWS_DONE)
    if options.method is CalibrationMethod.PAPER:
        if stack is not None:
            calibration_input = _narrowed(calibration_input, stack, options, on_progress, keeper)
        return calibration_input, _as_published(calibration_input, options, reporting.on_round, keeper)
    narrowed_result = None if stack is None else _in_phantom_rows(calibration_input, stack, options, on_progress)
    if narrowed_result is not None:
        return narrowed_result
    task = _task(calibration_input, options)
    return calibration_input, calibrate(task, seed=options.seed, progress=reporting.on_round, on_step=reporting.on_step)


def _narrowed(
    calibration_input: CalibrationInput,
    stack: NDArray[np.float32],
    options: contracts.CalibrationOptions,
    on_progress: ProgressCallback,
    keeper: Keeper,
) -> CalibrationInput:
    """Narrow the input to the rows that show the phantom; later attempts take the rows from the keeper."""
    kept = keeper.kept("rows")
    if kept is not None:
        first, last = kept["rows"].tolist()
        unchanged = (first, last) == calibration_input.rows
        views = calibration_input.of_views(stack)
        return calibration_input if unchanged else calibration_input.of_rows(views, (first, last))
    result = _in_phantom_rows(calibration_input, stack, options, on_progress)
    narrowed = calibration_input if result is None else result[0]
    if keeper.has_begun:
        keeper.keep("rows", {"rows": np.array(narrowed.rows)})
    return narrowed


def _with_odd_rows(calibration_input: CalibrationInput, stack: NDArray[np.float32]) -> CalibrationInput:
    """Add a remark that names the rows of a stack which show another body than most rows do."""
    first, last = calibration_input.rows
    odd = ", ".join(str(first + row) for row in odd_rows(stack))
    remark = AdjustmentMessage.ODD_ROWS(rows=f"{first}:{last}", odd=odd)
    return calibration_input.with_remark(remark) if odd else calibration_input


def _in_phantom_rows(
    calibration_input: CalibrationInput,
    stack: NDArray[np.float32],
    options: contracts.CalibrationOptions,
    on_progress: ProgressCallback,
) -> tuple[CalibrationInput, CalibrationOutcome] | None:
    """Calibrate with the rows that show the phantom; None where no row differs, or no run of rows fits the phantom."""
    stack = calibration_input.of_views(stack)
    runs = segments(stack)[:MOST_RUNS]
    if len(runs) <= 1:
        return None
    results: list[tuple[CalibrationInput, CalibrationOutcome]] = []
    for number, run in enumerate(runs, start=1):
        rows = (calibration_input.rows[0] + run.start, calibration_input.rows[0] + run.stop)
        narrowed = calibration_input.of_rows(stack, rows)
        start, end = (ROWS_DONE * each / len(runs) for each in (number - 1, number))
        reporting = SearchProgress(on_progress, start, end, stage="rows")
        try:
            task = _task(narrowed, options)
            results.append((narrowed, calibrate(task, seed=options.seed, on_step=reporting.on_step)))
        except CalibrationError:  # these rows show something else
            continue
        finally:
            on_progress(Progress(fraction=end, stage="rows"))
    return min(results, key=lambda one: one[1].findings.fit.relative_residual, default=None)


def _as_published(
    calibration_input: CalibrationInput, options: contracts.CalibrationOptions, on_round: SearchCallback, keeper: Keeper
) -> CalibrationOutcome:
    # Imported here because the module imports the reconstruction, which the default method does not need.
    from sawmill_tomography.calibration.paper import PaperSettings, calibrate_as_published  # noqa: PLC0415

    def keep(search: RecallingObjective) -> None:
        if keeper.is_due:
            keeper.keep("search", vars(search.evaluations()))

    earlier = keeper.kept("search")
    return calibrate_as_published(
        _task(calibration_input, options),
        options=PaperSettings(**options.paper.model_dump()),
        seed=options.seed,
        progress=on_round,
        earlier=None if earlier is None else Evaluations(**earlier),
        on_computed=keep,
    )


class SearchProgress:
    """Progress from `start` to `end` by a search's rounds, and once a second by its steps, whose number is unknown."""

    def __init__(
        self,
        on_progress: ProgressCallback,
        start: float,
        end: float = SEARCH_DONE,
        *,
        stage: str = "search",
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monotonic = monotonic
        self._on_progress, self._start, self._end = on_progress, start, end
        self._progress = Progress(fraction=start, stage=stage)
        self._steps, self._stepped_from, self._reported_at = 0, start, monotonic()

    def on_round(self, generation: int, most: int, best: float) -> None:
        """Report a round; before the first fit there is no best value."""
        fraction = min(self._start + (1.0 - self._start) * generation / most, self._end)
        self._steps, self._stepped_from = 0, max(fraction, self._progress.fraction)
        self._tell(
            replace(
                self._progress,
                fraction=self._stepped_from,
                generation=generation,
                best_value=best if math.isfinite(best) else None,
            )
        )

    def on_step(self) -> None:
        """Count one more step, and report the progress if a report is due."""
        self._steps += 1
        if self._monotonic() - self._reported_at >= STEPS_EVERY_S:
            remaining = (self._end - self._stepped_from) * MANY_STEPS / (self._steps + MANY_STEPS)
            self._tell(replace(self._progress, fraction=self._end - remaining))

    def _tell(self, progress: Progress) -> None:
        self._progress, self._reported_at = progress, self._monotonic()
        self._on_progress(progress)


def _task(calibration_input: CalibrationInput, chosen: contracts.CalibrationOptions) -> CalibrationTask:
    return CalibrationTask(
        scanner=calibration_input.scanner,
        phantom=to_phantom(calibration_input.drawing, chosen.size_tolerance_percent),
        sinogram=calibration_input.sinogram,
        angles_rad=calibration_input.angles_rad,
        bounds=calibration_input.bounds,
        handedness=chosen.handedness,
        rotation=chosen.rotation,
        rays_per_cell=chosen.rays_per_cell,
        log_radius_mm=calibration_input.limits.log_radius_mm,
        tolerance_mm=calibration_input.limits.tolerance_mm,
        scale_tolerance_percent=calibration_input.limits.scale_tolerance_percent,
        true_axis=chosen.true_axis or calibration_input.drawing.true_axis,
        from_counts=calibration_input.from_counts,
        without=frozenset(chosen.without),
        saturated_share=calibration_input.saturated_share,
    )


def calibration_result(
    calibration: CalibrationOutcome,
    calibration_input: CalibrationInput,
    comparison: contracts.Comparison | None = None,
    witness: contracts.LogCheck | None = None,
) -> contracts.CalibrationResult:
    """Convert a calibration to its contract; a scanner that moved is the first of the reasons."""
    findings, frame, judgement = calibration.findings, calibration.frame, calibration.judgement
    fit, bars = findings.fit, findings.error_bars
    exact = findings.alternatives.hypotheses[0].relative_residual <= 0.0
    behind = findings.alternatives.log_likelihood_behind
    moved = [] if comparison is None or comparison.within_tolerance else [comparison.explanation]
    measured = measurement_reasons(calibration_input.drawing, datetime.now(tz=UTC).date())
    reasons = [*moved, *map(CodedReason.of, (*judgement.reasons, *measured))]
    adjustments = [CodedReason.of(each) for each in (*calibration_input.remarks, *calibration.adjustments)]
    return contracts.CalibrationResult(
        theta=calibration.theta,
        theta_twin=calibration.theta_twin,
        source_frame=frame,
        standard_deviation=bars and from_deviation(bars.theta_deviation, bars.frame_deviation(frame)),
        covariance=bars and bars.covariance.values.tolist(),
        theta_covariance=None if bars is None or bars.theta_covariance is None else bars.theta_covariance.tolist(),
        predicted_ray_error_mm=bars
        and from_predicted(
            bars.predicted_ray_error, calibration.scanner, frame, bars.statistics.ray_covariance, calibration.radius_mm
        ),
        unconstrained_source_distance_mm=findings.source_distance.unconstrained_mm,
        scale_uncertainty_mm=findings.scale.source_distance_mm,
        scale_ray_error_mm=findings.scale.ray_error_mm,
        scale_uncertainty_percent=findings.scale.percent_95,
        uncertainty_budget=uncertainty_budget(calibration),
        handedness=calibration.handedness,
        rotation=calibration.rotation,
        hypotheses=[
            contracts.Hypothesis(**vars(one), log_likelihood_behind=None if exact else behind(one.relative_residual))
            for one in findings.alternatives.hypotheses
        ],
        phantom_position_mm=fit.position_mm,
        gain=fit.gain,
        offset=fit.offset,
        residual=contracts.Residual(rms=fit.residual_rms, relative=fit.relative_residual),
        beam_hardening=calibration.beam.hardening,
        scattered_radiation=calibration.beam.scatter,
        adjustments=[each.sentence for each in adjustments],
        coded_adjustments=adjustments,
        status=judgement.status,
        verdict=judgement.verdict,
        rays_verdict=judgement.rays_verdict,
        limits=calibration_input.limits,
        reasons=[each.sentence for each in reasons],
        coded_reasons=reasons,
        scanner=calibration_input.scanner.with_cells_of(calibration.scanner),
        phantom=calibration_input.drawing.name,
        views=int(calibration_input.angles_rad.size),
        rows=calibration_input.rows,
        search=contracts.Search(**{name: getattr(calibration.search, name) for name in contracts.Search.model_fields}),
        timing_s=contracts.Timing(**vars(calibration.timing)),
        software_version=VERSION,
        input_sha256=calibration_input.input_sha256,
        comparison=comparison,
        log_check=witness,
    )


def measurement_reasons(drawing: PhantomDrawing, today: date) -> Iterator[Reason]:
    """Yield a reason for each measurement that has expired, and for each measurement that contradicts the drawing."""
    extent_mm = np.ptp(np.concatenate(to_phantom(drawing).outlines()), axis=0)
    for measured in drawing.measurements:
        values: dict[str, Value] = {
            "what": measured.dimension,
            "measured_mm": measured.measured_mm,
            "error_mm": measured.standard_uncertainty_mm,
        }
        if measured.expired(today):
            yield CalibrationMessage.MEASUREMENT_EXPIRED(**values, expired_on=str(measured.expires_on))
        axis = AXES.get(measured.dimension)
        if axis is None:
            continue
        drawn_mm = float(extent_mm[axis])
        if abs(drawn_mm - measured.measured_mm) > CONTRADICTION * measured.standard_uncertainty_mm:
            yield CalibrationMessage.NOT_AS_MEASURED(**values, drawn_mm=drawn_mm)
