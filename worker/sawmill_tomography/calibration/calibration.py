"""What a calibration answers, composed of the values that its stages found."""

from dataclasses import dataclass

from sawmill_tomography.calibration.alternatives import Alternatives
from sawmill_tomography.calibration.error_bars import ErrorBars
from sawmill_tomography.calibration.fit import FittedModel
from sawmill_tomography.calibration.judgement import Evidence, Judgement
from sawmill_tomography.calibration.scale import ScaleUncertainty
from sawmill_tomography.calibration.search import SearchReport
from sawmill_tomography.calibration.source_distance import SourceDistance
from sawmill_tomography.calibration.task import CalibrationTask, PoseHypothesis
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, ThetaBounds
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import Handedness, Rotation
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection


@dataclass(frozen=True)
class StageSeconds:
    """Seconds; total runs from the sinogram in memory to the complete answer."""

    total: float
    search: float
    refine: float
    uncertainty: float


@dataclass(frozen=True, eq=False)
class CalibrationOutcome:
    """The complete answer.

    Attributes
    ----------
    task : CalibrationTask
        What was asked.
    theta_twin : Theta or None
        The other theta with the same sinogram.
    model, residual : (views, cells) float64
        Of the sinogram that was asked about: their sum.
    error_bars : ErrorBars or None
        None from a method that has none.
    adjustments : tuple of str
        What was found in the scan beyond the plain model, and what was done about it.
    evidence : Evidence or None
        What it was judged by; None from a method that has no error bars.
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
        """The geometry found."""
        return self.fit.frame

    @property
    def handedness(self) -> Handedness:
        """From which side the phantom was seen."""
        return self.hypothesis.handedness

    @property
    def rotation(self) -> Rotation:
        """In which sense the view angles count."""
        return self.hypothesis.rotation

    @property
    def seen(self) -> Phantom:
        """The phantom as the scan shows it, in the image frame of theta."""
        return self.task.phantoms[self.handedness].moved(*self.fit.position_mm)

    @property
    def radius_mm(self) -> float:
        """Of the disc in which ray errors are counted."""
        return self.task.radius_mm(self.handedness, self.fit.position_mm)

    @property
    def geometry(self) -> "CalibratedGeometry":
        """What is compared with another calibration, and used to reconstruct."""
        covariance = None if self.error_bars is None else self.error_bars.covariance.values
        return CalibratedGeometry(self.scanner, self.theta, self.frame, self.rotation, covariance)


@dataclass(frozen=True, eq=False)
class CalibratedGeometry:
    """The geometry of a calibration, its sense of rotation and its covariance (5, 5), where it has one."""

    scanner: Scanner
    theta: Theta
    frame: SourceFrame
    rotation: Rotation
    covariance: FloatArray | None


def choose_theta(scanner: Scanner, frame: SourceFrame, bounds: ThetaBounds | None) -> tuple[Theta, Theta | None]:
    """The theta to report and its twin: the one inside the bounds, else the one with h_S >= 0."""
    theta = frame.theta(scanner.source_to_cor_mm)
    if theta.source_shift_mm == 0.0:
        return theta, None
    twin = theta.twin(scanner.source_to_cor_mm)
    if bounds is not None and bounds.contain(twin) and not bounds.contain(theta):
        return twin, theta
    return theta, twin
