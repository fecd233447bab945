"""The outcome of a calibration, composed of the results of the stages."""

from dataclasses import dataclass

from sawmill_tomography.calibration.alternatives import Alternatives
from sawmill_tomography.calibration.error_bars import ErrorBars
from sawmill_tomography.calibration.fit import FittedModel
from sawmill_tomography.calibration.judgement import Evidence, Judgement
from sawmill_tomography.calibration.scale import ScaleUncertainty
from sawmill_tomography.calibration.search.search import SearchReport
from sawmill_tomography.calibration.source_distance import SourceDistance
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, ThetaBounds
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import Handedness, Rotation
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection


@dataclass(frozen=True)
class StageSeconds:
    """Seconds of the stages; `total` runs from the sinogram in memory to the complete outcome."""

    total: float
    search: float
    refine: float
    uncertainty: float


@dataclass(frozen=True, eq=False)
class CalibrationOutcome:
    """The complete outcome of a calibration.

    Attributes
    ----------
    task : CalibrationTask
        The task that was calibrated.
    theta_twin : Theta or None
        The other theta with the same sinogram.
    model, residual : (views, cells) float64
        Model sinogram and residual; their sum is the task's sinogram.
    error_bars : ErrorBars or None
        None from a method without error bars.
    adjustments : tuple of str
        Sentences on effects and faults in the scan beyond the plain model, and on what was done about each.
    evidence : Evidence or None
        The evidence that the judgement is based on; None from a method without error bars.
    beam : BeamCorrection
        Hardening and scatter, None where they were not fitted.
    """

    task: CalibrationTask
    hypothesis: PoseHypothesis
    theta: Theta
    theta_twin: Theta | None
    fit: FittedModel
    model: FloatArray
    residual: FloatArray
    source_distance: SourceDistance
    scale: ScaleUncertainty
    error_bars: ErrorBars | None
    alternatives: Alternatives
    adjustments: tuple[str, ...]
    judgement: Judgement
    search: SearchReport
    timing: StageSeconds
    evidence: Evidence | None = None
    beam: BeamCorrection = NOTHING_FOUND

    @property
    def scanner(self) -> Scanner:
        """The scanner's known constants."""
        return self.task.scanner

    @property
    def frame(self) -> SourceFrame:
        """The calibrated geometry."""
        return self.fit.frame

    @property
    def handedness(self) -> Handedness:
        """Side from which the phantom was seen."""
        return self.hypothesis.handedness

    @property
    def rotation(self) -> Rotation:
        """Sense in which the view angles count."""
        return self.hypothesis.rotation

    @property
    def seen(self) -> Phantom:
        """The phantom as the scan shows it, in the image frame of theta."""
        return self.task.phantoms[self.handedness].moved(*self.fit.position_mm)

    @property
    def radius_mm(self) -> float:
        """Radius of the disc in which ray errors are counted, mm."""
        return self.task.radius_mm(self.handedness, self.fit.position_mm)

    @property
    def geometry(self) -> "CalibratedGeometry":
        """Geometry for comparisons with another calibration, and for reconstruction."""
        covariance = None if self.error_bars is None else self.error_bars.covariance.values
        return CalibratedGeometry(self.scanner, self.theta, self.frame, self.rotation, covariance)


@dataclass(frozen=True, eq=False)
class CalibratedGeometry:
    """A calibration's geometry, sense of rotation, and covariance (5, 5) or None."""

    scanner: Scanner
    theta: Theta
    frame: SourceFrame
    rotation: Rotation
    covariance: FloatArray | None


def choose_theta(scanner: Scanner, frame: SourceFrame, bounds: ThetaBounds | None) -> tuple[Theta, Theta | None]:
    """Select the theta to report, and its twin: report the theta inside the bounds, else the theta with h_S >= 0."""
    theta = frame.theta(scanner.source_to_cor_mm)
    if theta.source_shift_mm == 0.0:
        return theta, None
    twin = theta.twin(scanner.source_to_cor_mm)
    if bounds is not None and bounds.contain(twin) and not bounds.contain(theta):
        return twin, theta
    return theta, twin
