"""The published calibration: differential evolution on the correlation of FBP images (arXiv 2206.14444).

J(theta) = -max(<X_ref, FBP_theta>, <mirror X_ref, FBP_theta>), best/1/bin, crossover 0.7, mutation dithered in
[0.5, 1]. The method serves comparisons, and gives no error bars.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

import sawmill_vocabulary as vocabulary
from sawmill_tomography.calibration.alternatives import Alternatives, HypothesisReport
from sawmill_tomography.calibration.calibration import CalibrationOutcome, StageSeconds, choose_theta
from sawmill_tomography.calibration.fit import FittedModel
from sawmill_tomography.calibration.judgement import (
    Degree,
    Findings,
    Judgement,
    JudgementLimits,
    Remark,
    combined,
    implausible,
    saturation,
)
from sawmill_tomography.calibration.recalling import Evaluations, RecallingObjective
from sawmill_tomography.calibration.refusals import NOT_FOUND, CalibrationError
from sawmill_tomography.calibration.scale import scale_uncertainty
from sawmill_tomography.calibration.search.search import SearchCallback, SearchReport
from sawmill_tomography.calibration.source_distance import SourceDistance
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import (
    FanBeamGeometry,
    FloatArray,
    GeometryError,
    SourceFrame,
    Theta,
    ThetaBounds,
    bounds_array,
)
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp
from sawmill_vocabulary import (
    CalibrationStatus,
    FilterName,
    Handedness,
    PaperCorrelation,
    PaperStop,
    Rotation,
    Weighting,
)
from sawmill_vocabulary.calibration_messages import CalibrationMessage

AnyFloats = NDArray[np.floating[Any]]
Pair = tuple[AnyFloats, AnyFloats]


@dataclass(frozen=True)
class PaperSettings:
    """Switches of the published search."""

    # "image" correlates the FBP with the drawing; "projection" correlates sinograms, reported as worse
    objective: vocabulary.PaperObjective = "image"
    weighting: Weighting = "none"
    correlation: PaperCorrelation = "unnormalised"
    # "published" is SciPy's default (0.01 of the mean, then a polish); "tight" waits until the population agrees
    stop: PaperStop = "published"
    max_generations: int = 1000
    image_size: int = 256
    field_mm: float = 400.0  # side of the image; the published drawing's is 400 mm
    filter_name: FilterName = FilterName.HANN


def remove_background(sinogram: FloatArray) -> FloatArray:
    """Subtract the air level, the median of the lowest tenth of the range: a constant background biases J."""
    low, high = np.percentile(sinogram, [1.0, 99.0])
    return sinogram - float(np.median(sinogram[sinogram <= low + 0.1 * (high - low)]))


class PaperObjective:
    """J(theta) for one sense of rotation; lower is better."""

    def __init__(self, task: CalibrationTask, rotation: Rotation, options: PaperSettings) -> None:
        self._task, self._options = task, options
        self._angles = rotation.apply(task.angles_rad)
        self._data = remove_background(task.sinogram)
        self._grid = ImageGrid(options.image_size, options.field_mm)
        self._phantoms = task.phantoms
        self._references = {
            h: phantom.rasterise(options.image_size, options.field_mm) for h, phantom in self._phantoms.items()
        }

    @property
    def scale(self) -> float:
        """Value of -J for a perfect answer."""
        if self._options.correlation == "normalised":
            return 1.0
        if self._options.objective == "projection":
            return float((self._data**2).sum())
        return float(max((reference**2).sum() for reference in self._references.values()))

    def __call__(self, vector: FloatArray) -> float:
        """Evaluate J at (alpha0, r_D, h_S, h_D, alpha_D); 0, no correlation, where no such scanner can be."""
        return -max(self.correlations(Theta.from_vector(vector)).values())

    def correlations(self, theta: Theta) -> dict[Handedness, float]:
        """Compute the correlation with the phantom as drawn and from behind."""
        try:
            pairs = self._image_pairs(theta) if self._options.objective == "image" else self._sinogram_pairs(theta)
        except GeometryError:  # the search box of theta holds scanners whose source is inside the field
            return dict.fromkeys(self._phantoms, 0.0)
        return {h: self._correlation(a, b) for h, (a, b) in pairs.items()}

    def _image_pairs(self, theta: Theta) -> dict[Handedness, Pair]:
        image = fbp(
            Projector(FanBeamGeometry(self._task.scanner, theta, self._angles), self._grid),
            self._data,
            filter_name=self._options.filter_name,
            weighting=self._options.weighting,
        ).image
        return {h: (reference, image) for h, reference in self._references.items()}

    def _sinogram_pairs(self, theta: Theta) -> dict[Handedness, Pair]:
        frame = theta.source_frame(self._task.scanner.source_to_cor_mm)
        cells = DetectorCells.of(self._task.scanner)
        return {h: (analytic.project(p, cells, frame, self._angles), self._data) for h, p in self._phantoms.items()}

    def _correlation(self, a: AnyFloats, b: AnyFloats) -> float:
        product = float(np.vdot(a, b))
        if self._options.correlation == "unnormalised":
            return product
        norm = float(np.linalg.norm(a) * np.linalg.norm(b))
        return product / norm if norm > 0.0 else 0.0


def calibrate_as_published(
    task: CalibrationTask,
    *,
    options: PaperSettings | None = None,
    seed: int = 7,
    progress: SearchCallback | None = None,
    earlier: Evaluations | None = None,
    on_computed: Callable[[RecallingObjective], None] | None = None,
) -> CalibrationOutcome:
    """Calibrate by the published search, with a seed; the view angles count as given unless the task has a rotation.

    Parameters
    ----------
    earlier : Evaluations, optional
        Evaluations of the same search before it was stopped: the search continues to the same answer, bit for bit.
    on_computed : callable, optional
        Called after each evaluation of the objective, with the object that has all evaluations.

    Raises
    ------
    CalibrationError
        If no scanner can be at theta's best value.
    """
    started = time.perf_counter()
    chosen = options or PaperSettings()
    rotation = task.rotation or Rotation.AS_GIVEN
    objective = PaperObjective(task, rotation, chosen)
    recalling = RecallingObjective(objective, earlier, on_computed)
    bounds = bounds_array(task.bounds or ThetaBounds())

    history: list[tuple[int, float]] = []

    def report(intermediate_result: object) -> None:
        best = getattr(intermediate_result, "fun", math.nan)
        SearchReport.note(history, recalling.count, float(best))
        if progress is not None and not recalling.recalls:
            progress(getattr(intermediate_result, "nit", 0), chosen.max_generations, best)

    # To the digits of the image's numbers, against the objective of a perfect image; otherwise SciPy's default.
    spread: dict[str, Any] = (
        {"tol": 0.0, "atol": float(np.finfo(np.float32).resolution) * objective.scale} if chosen.stop == "tight" else {}
    )
    outcome = scipy.optimize.differential_evolution(
        recalling,
        scipy.optimize.Bounds(bounds[:, 0], bounds[:, 1]),
        strategy="best1bin",
        recombination=0.7,
        mutation=(0.5, 1.0),
        maxiter=chosen.max_generations,
        rng=np.random.default_rng(seed),
        callback=report,
        **spread,
    )
    SearchReport.note(history, recalling.count, float(outcome.fun))  # the polish comes after the last generation
    search = SearchReport(
        "differential-evolution on FBP correlation"
        if chosen.objective == "image"
        else "differential-evolution on sinogram correlation",
        seed,
        recalling.count,
        int(outcome.nit),
        float(outcome.fun),
        bool(outcome.success),
        str(outcome.message),
        tuple(history),
    )
    return _answer(task, Theta.from_vector(outcome.x), rotation, objective, search, started)


def _answer(
    task: CalibrationTask,
    theta: Theta,
    rotation: Rotation,
    objective: PaperObjective,
    search: SearchReport,
    started: float,
) -> CalibrationOutcome:
    searched = time.perf_counter()
    correlations = objective.correlations(theta)
    handedness = max(correlations, key=lambda h: correlations[h])
    data = task.full_data(rotation)
    frame = theta.source_frame(task.scanner.source_to_cor_mm)
    try:
        fitted = {h: _explain(task, h, rotation, theta) for h in task.phantoms}
    except GeometryError as error:
        raise CalibrationError("no-geometry", str(error)) from error
    gain, offset, model = fitted[handedness]
    residual = data.sinogram - model
    spread = float(data.sinogram.std())
    rms = float(np.sqrt(np.mean(residual**2)))
    reported, twin = choose_theta(task.scanner, frame, task.bounds or ThetaBounds())
    ended = time.perf_counter()
    hypotheses = sorted(
        (HypothesisReport(h, rotation, float((data.sinogram - m).std()) / spread) for h, (_, _, m) in fitted.items()),
        key=lambda report: report.handedness is not handedness,
    )
    return CalibrationOutcome(
        task=task,
        hypothesis=PoseHypothesis(handedness, rotation),
        theta=reported,
        theta_twin=twin,
        findings=Findings(
            fit=FittedModel(frame, (0.0, 0.0), gain, offset, rms, rms / spread),
            source_distance=SourceDistance(frame.source_distance_mm),
            alternatives=Alternatives(tuple(hypotheses)),
            scale=scale_uncertainty(task.scanner, frame, task.phantom, None, task.radius_mm(handedness, (0.0, 0.0))),
            error_bars=None,
        ),
        residual=residual,
        adjustments=(),
        judgement=_judgement(task, frame, hypotheses[0].relative_residual),
        search=search,
        timing=StageSeconds(ended - started, searched - started, 0.0, 0.0),
    )


def _judgement(task: CalibrationTask, frame: SourceFrame, unexplained: float) -> Judgement:
    remarks = [
        *saturation(task.saturated_share),
        *implausible(frame, JudgementLimits.of(task)),
        Remark(Degree.WATCH, CalibrationMessage.WITHOUT_ERROR_BARS(), CalibrationStatus.WITHOUT_ERROR_BARS),
    ]
    if unexplained >= NOT_FOUND:
        reason = CalibrationMessage.UNEXPLAINED(share_percent=100.0 * unexplained)
        remarks.insert(0, Remark(Degree.FAIL, reason, CalibrationStatus.NOT_CONVERGED))
    if task.rotation is None:
        remarks.append(Remark(Degree.WATCH, CalibrationMessage.ROTATION_TAKEN()))
    return combined(remarks)


def _explain(
    task: CalibrationTask, handedness: Handedness, rotation: Rotation, theta: Theta
) -> tuple[float, float, FloatArray]:
    """Compute the gain, offset and model sinogram that explain most of the data at theta."""
    data = task.full_data(rotation)
    frame = theta.source_frame(task.scanner.source_to_cor_mm)
    shadow = analytic.project(
        task.phantoms[handedness], data.cells, frame, data.angles_rad, rays_per_cell=data.rays_per_cell
    )
    centred = shadow - shadow.mean()
    power = float((centred**2).sum())
    gain = float((centred * data.sinogram).sum()) / power if power > 0.0 else 0.0
    offset = float(data.sinogram.mean()) - gain * float(shadow.mean())
    return gain, offset, gain * shadow + offset
