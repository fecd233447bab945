"""Drift: what an ordinary log scan says of a calibration, without a phantom."""

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Rows, Stamped
from sawmill_worker.contracts.choices import DisturbedPart
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.given import Given
from sawmill_worker.contracts.jobs import Failure, JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, Operation, Reference, stored_as
from sawmill_worker.vocabulary import Rotation


class DriftOptions(Contract):
    """Which part of the scan is looked at."""

    rows: Rows | None = Field(
        None, description="Detector rows A:B to average, the first included, the last not. By default all of them."
    )


class DriftAsk(DriftOptions, Given):
    """Ask whether a scanner has moved since a calibration. The scan must go all round in steps of 3 degrees or less."""

    scan_id: Identifier = Field(examples=["example"])
    calibration_id: Identifier | None = Field(
        None, description="To compare with; null: the scanner's active calibration.", examples=["example"]
    )


class DetectorGeometry(Contract):
    """The part of the geometry that pairs of opposite rays show."""

    cor_column_mm: float = Field(description="u_c, where the centre of rotation falls on the detector.")
    tilt_rad: float = Field(description="tau, tilt of the detector against the ray through the centre of rotation.")
    source_to_detector_mm: float = Field(description="SDD along that ray; only weakly seen, and held where it is not.")


class DetectorDeviation(Contract):
    """A standard deviation of each, or how many of them; null for the distance where the scan does not show it."""

    cor_column_mm: float
    tilt_rad: float
    source_to_detector_mm: float | None


class TurnDisturbance(Contract):
    """A harmonic of the turn itself, fitted with the geometry: it is neither drift nor part of the change."""

    part: DisturbedPart = Field(
        description="`encoder`: the angles run ahead and behind. `bearing`: the log swings across the beam."
    )
    times_a_turn: int
    amplitude_deg: float | None = Field(None, description="Of the encoder.")
    amplitude_mm: float | None = Field(None, description="Of the bearing, across the beam at the centre of rotation.")


class DriftResult(Contract):
    """The answer: what moved, how surely, and what cannot be seen."""

    measured: DetectorGeometry
    standard_deviation: DetectorDeviation = Field(description="Of what was measured.")
    covariance: list[list[float]] = Field(
        description="Of what was measured: (cor_column_mm, tilt_rad, source_to_detector_mm)."
    )
    calibrated: DetectorGeometry
    change: DetectorGeometry = Field(description="Measured less calibrated.")
    change_standard_deviation: DetectorDeviation = Field(
        description="From this scan's errors and, where they are known, the calibration's."
    )
    significance: DetectorDeviation = Field(description="Each change in units of its standard deviation.")
    moved: bool = Field(description="Whether any change is beyond three standard deviations.")
    ray_change_mm: float = Field(
        description="RMS distance between the rays inside the log's disc, up to a common scale, with what this scan "
        "cannot see unchanged; a distance of the detector that has not significantly changed is held too."
    )
    ray_change_uncertainty_mm: float = Field(description="RMS ray distance that the errors alone bring about.")
    scale_change_percent: float | None = Field(
        None,
        description="Change of the image's size, which the ray change leaves out. Null: from an earlier version.",
    )
    scale_change_uncertainty_percent: float | None = Field(None, description="Of the change of scale, 95 %.")
    radius_mm: float = Field(description="Of the disc in which rays are compared.")
    tolerance_mm: float = Field(description="RMS ray distance up to which nothing moved.")
    within_tolerance: bool | None = Field(description="Null: the scan is too uncertain to say.")
    reason: str = Field(description="A likely cause and what to do, in one sentence.")
    not_seen: list[str] = Field(description="What no scan without a phantom can show.")
    rotation: Rotation = Field(description="The sense of rotation in which opposite rays agree.")
    rotation_ratio: float = Field(description="How many times worse they agree in the other sense.")
    rotation_decided: bool = Field(description="False: a log too round and centred to tell; the calibration's is kept.")
    relative_residual: float = Field(description="What opposite rays differ by, against what changes with the view.")
    disturbances: list[TurnDisturbance] = Field(
        default_factory=list,
        description="What disturbs the turn beyond chance. What is not found widens the standard deviations.",
    )
    adjustments: list[str] = Field(
        default_factory=list, description="What was done to the scan before it was used, a sentence each."
    )
    scanner: ScannerConstants
    views: int
    rows: tuple[int, int] = Field(description="First row and the one after the last.")
    time_s: float
    software_version: str
    input_sha256: str


class DriftLinks(Contract):
    """Where it hangs together."""

    self: str
    job: str
    calibration: str


class Drift(Stamped):
    """A drift check as it stands."""

    state: JobState
    scanner_id: Identifier
    scan_id: Identifier
    calibration_id: Identifier
    job_id: Identifier
    options: DriftOptions
    result: DriftResult | None = None
    failure: Failure | None = None
    links: DriftLinks | None = None


DECLARATION = AskedKind(
    kind=JobKind.DRIFT,
    noun="drift",
    lighter="ask for fewer rows",
    ask=DriftAsk,
    options=DriftOptions,
    result=DriftResult,
    answer=Drift,
    read=stored_as(Drift),
    links=DriftLinks,
    references=(Reference.SCAN, Reference.CALIBRATION),
    is_short=lambda _: True,
    listed_by=("scanner_id", "scan_id", "state"),
    to_ask=Operation(
        "Look for drift without a phantom",
        """\
What moved since a calibration, from any scan that goes all round in steps of 3 degrees or less.

Every ray is measured twice, from either side; where the two agree shows where the centre of rotation falls on the
detector, and the detector's tilt. The source's distance and the first angle cannot be seen.
The scan may still be read and the calibration still computed: the job waits for them.""",
        {"body": {"scan_id": "example"}},
    ),
    to_list=Operation(
        "List drift checks, newest first", "All of them, or those of one scanner or scan, or in one state."
    ),
    to_get=Operation(
        "Get a drift check", "Its state, and what moved, how surely and where to look once that is known."
    ),
)
