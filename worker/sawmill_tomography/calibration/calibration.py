"""The outcome of a calibration, composed of the results of the stages."""

from dataclasses import dataclass

from sawmill_tomography.calibration.judgement import Findings, Judgement
from sawmill_tomography.calibration.search.search import SearchReport
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
    """The complete outcome of a calibration."""

    task: CalibrationTask  # the task that was calibrated
    hypothesis: PoseHypothesis
    theta: Theta
    theta_twin: Theta | None  # the other theta with the same sinogram
    findings: Findings  # `Evidence` from a method with error bars
    residual: FloatArray  # (views, cells): the task's sinogram less the model
    # Sentences on effects and faults in the scan beyond the plain model, and on what was done about each
    adjustments: tuple[str, ...]
    judgement: Judgement
    search: SearchReport
    timing: StageSeconds
    # (views, 3): changes of (psi, t_x, t_y), rad and mm, where each view has another pose
    view_poses: FloatArray | None = None
    beam: BeamCorrection = NOTHING_FOUND  # hardening and scatter, None where they were not fitted

    @property
    def scanner(self) -> Scanner:
        """The scanner's known constants."""
        return self.task.scanner

    @property
    def frame(self) -> SourceFrame:
        """The calibrated geometry."""
        return self.findings.fit.frame

    @property
    def model(self) -> FloatArray:
        """Model sinogram, (views, cells) float64."""
        return self.task.sinogram - self.residual

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
        return self.task.phantoms[self.handedness].moved(*self.findings.fit.position_mm)

    @property
    def radius_mm(self) -> float:
        """Radius of the disc in which ray errors are counted, mm."""
        return self.task.radius_mm(self.handedness, self.findings.fit.position_mm)

    @property
    def geometry(self) -> "CalibratedGeometry":
        """Geometry for comparisons with another calibration, and for reconstruction."""
        bars = self.findings.error_bars
        covariance = None if bars is None else bars.covariance.values
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
