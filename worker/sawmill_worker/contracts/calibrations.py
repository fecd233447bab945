"""Calibrations: what can be asked, and the answer with everything that is known about it."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self
from uuid import uuid4

from pydantic import Field
from typing_extensions import TypeAliasType

from sawmill_worker.contracts.base import Contract, Identifier, PositiveMm, Rows, Stamped
from sawmill_worker.contracts.choices import (
    Axis,
    PaperCorrelation,
    PaperObjective,
    PaperStop,
    UnfinishedState,
    Verdict,
    Weighting,
    WitnessTaken,
)
from sawmill_worker.contracts.geometry import (
    ReportedSourceFrame,
    ScannerConstants,
    SourceFrameDeviation,
    ThetaDeviation,
)
from sawmill_worker.contracts.given import Given
from sawmill_worker.contracts.jobs import Failure, JobKind
from sawmill_worker.contracts.keys import Scope
from sawmill_worker.contracts.kinds import AskedKind, Operation, Reference
from sawmill_worker.contracts.phantoms import SizeTolerancePercent
from sawmill_worker.vocabulary import (
    LARGEST_ASSUMED_LOG_RADIUS_MM,
    STANDARD_SIZE_TOLERANCE,
    Adjustment,
    Agreement,
    CalibrationMethod,
    CalibrationStatus,
    Handedness,
    MovedBody,
    Rotation,
    Theta,
)


class PaperOptions(Contract):
    """Switches of the published search (arXiv 2206.14444)."""

    objective: PaperObjective = Field("image", description="Correlate FBP images, or compare sinograms.")
    weighting: Weighting = Field("none", description="FBP weights; the published pipeline has none.")
    correlation: PaperCorrelation = Field(
        "unnormalised", description="Of images or sinograms: as published, or normalised."
    )
    stop: PaperStop = Field("published", description="SciPy's default stop, or one that waits for convergence.")
    max_generations: Annotated[int, Field(ge=1, le=10_000)] = Field(
        1000, description="The search ends after this number of generations."
    )
    image_size: Annotated[int, Field(ge=32, le=1024)] = Field(
        256, description="Pixels along each side of the correlated images."
    )


class CalibrationOptions(Contract):
    """How to calibrate, apart from what."""

    rows: Rows | None = Field(
        None,
        description="Detector rows A:B to average, the first included, the last not. By default the scan's phantom "
        "rows, else they are found.",
    )
    log_rows: Rows | None = Field(
        None,
        description="Detector rows A:B that show a log beside the phantom, the second witness for u_c and tilt. By "
        "default they are looked for.",
    )
    views: Annotated[int, Field(ge=3)] | None = Field(
        None, description="Use every (total / views)-th view, each with its own angle. By default all."
    )
    handedness: Handedness | None = Field(
        None, description="From which end the phantom was seen. By default the scanner's, else both are tried."
    )
    rotation: Rotation | None = Field(
        None, description="Which way the angles count. By default the scanner's, else both are tried."
    )
    method: CalibrationMethod = Field(
        CalibrationMethod.DEFAULT, description="The product's own search, or the published one."
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(7, description="Of the search.")
    rays_per_cell: Annotated[int, Field(ge=1, le=64)] | None = Field(
        None, description="Rays a cell in the model. By default the average over the whole cell, as of a real detector."
    )
    without: list[Adjustment] = Field(
        [], max_length=len(Adjustment), description="Corrections of a scan with faults that are left out."
    )
    size_tolerance_percent: SizeTolerancePercent | None = Field(
        None,
        description="Relative standard uncertainty of the phantom's size, in per cent. By default that of its drawing, "
        f"{100 * STANDARD_SIZE_TOLERANCE:g} where nobody stated one.",
    )
    true_axis: Axis | None = Field(
        None,
        description="Axis of the drawing along which the phantom's size is right. By default the drawing's, else "
        "neither: half the difference between the two is then added to the scale's uncertainty.",
    )
    paper: PaperOptions = PaperOptions()


class GivenCalibrationOptions(CalibrationOptions, Given):
    """How to calibrate, as somebody asks for it; an earlier version took what is refused here."""


class CalibrationAsk(GivenCalibrationOptions):
    """Ask for a calibration."""

    scan_id: Identifier = Field(examples=["example"])
    phantom_id: Identifier | None = Field(
        None, description="Null: the phantom that the scan names.", examples=["l-shape"]
    )
    activate: bool = Field(
        default=False,
        description="Make it the scanner's active calibration if its rays_verdict is pass: an uncertain scale blurs "
        "nothing and does not stop it.",
    )


class CalibrationLimits(Contract):
    """What an answer is held against, where no scanner is registered that has tolerances."""

    tolerance_mm: PositiveMm = 0.1
    scale_tolerance_percent: Annotated[float, Field(gt=0, le=100)] = 0.5
    log_radius_mm: PositiveMm | None = None


class StandardDeviation(Contract):
    """Of theta and of the source frame."""

    theta: ThetaDeviation
    source_frame: SourceFrameDeviation


class PredictedRayError(Contract):
    """The ray error that the covariance predicts, inside the log's disc."""

    rms: float = Field(description="Root of the expected mean square over rays and points.")
    max: float = Field(description="Standard deviation at the worst point.")
    upper_95: float = Field(description="The RMS ray error stays below this in 95 of 100 cases.")
    interval_95: tuple[float, float] | None = Field(
        None, description="It lies between these in 95 of 100 cases. Null: an answer of an earlier version."
    )
    radius_mm: float = Field(description="Of the disc in which rays are compared.")


class Residual(Contract):
    """What the model leaves of the sinogram."""

    rms: float = Field(description="In the unit of the sinogram.")
    relative: float = Field(description="Against the RMS of the background-free sinogram.")


class Hypothesis(Contract):
    """One of the four: handedness and sense of rotation."""

    handedness: Handedness
    rotation: Rotation
    relative_residual: float
    log_likelihood_behind: float | None = Field(
        None, description="Behind the best one's; below 10 the scan does not decide. Null without error bars."
    )


class Search(Contract):
    """How the basin was found."""

    method: str
    seed: int
    evaluations: int
    generations: int
    best_value: float
    converged: bool
    message: str


class Timing(Contract):
    """Seconds; total runs from the sinogram in memory to the complete answer."""

    total: float
    search: float
    refine: float
    uncertainty: float


class Comparison(Contract):
    """Against the scanner's active calibration."""

    calibration_id: Identifier
    ray_change_mm: float = Field(
        description="RMS distance between the two calibrations' rays inside the log's disc, one common rotation and "
        "one common scale taken out."
    )
    scale_change_percent: float | None = Field(
        None, description="Change of that common scale. Null: an answer of an earlier version, which did not report it."
    )
    scale_change_uncertainty_percent: float | None = Field(
        None, description="Of the change of scale, 95 %, from both covariances; null without error bars."
    )
    angle_change_deg: float = Field(description="Change of the first angle.")
    cor_column_change_mm: float
    source_distance_change_mm: float
    tilt_change_deg: float
    tolerance_mm: float | None = Field(
        None, description="What `ray_change_mm` may be. Null: an answer of an earlier version."
    )
    within_tolerance: bool
    reason: str


class ColumnAndTilt(Contract):
    """What the phantom's rows and the log's rows both show."""

    cor_column_mm: float
    tilt_rad: float


class SecondWitness(Contract):
    """The log beside the phantom: by opposite rays its rows give u_c and the tilt too."""

    log_rows: tuple[int, int] = Field(description="First row that shows the log and the one after the last.")
    log_rows_averaged: int = Field(description="The number of them that was averaged, evenly spaced.")
    log: ColumnAndTilt
    log_standard_deviation: ColumnAndTilt
    phantom: ColumnAndTilt = Field(description="Of the phantom's rows alone.")
    phantom_standard_deviation: ColumnAndTilt
    difference: ColumnAndTilt = Field(description="The log's less the phantom's.")
    difference_standard_deviation: ColumnAndTilt
    reported: ColumnAndTilt = Field(description="What follows from both, as source_frame has it.")
    reported_standard_deviation: ColumnAndTilt
    chi_squared: float = Field(description="Of the difference, with 2 degrees of freedom.")
    ray_change_mm: float = Field(description="RMS distance that the difference makes to the rays in the log's disc.")
    agreement: Agreement = Field(
        description="agree: chi_squared is below 5.99 (95 %). strained: below 13.8 (99.9 %), combined and widened. "
        "disagree: above."
    )
    moved: MovedBody | None = Field(description="Which body moved during the scan, where one did.")
    taken: WitnessTaken = Field(description="Whose u_c and tilt are reported; both: combined by their covariances.")
    log_jump_mm: float = Field(description="The jump of the log that its opposite rays show, in noise or beyond it.")
    log_jump_view: int = Field(description="The first view after it.")
    reason: str


class CalibrationResult(Contract):
    """The answer; also RESULT.json of the command line, which alone is enough to reconstruct."""

    theta: Theta
    theta_twin: Theta | None = Field(
        description="The other theta with the same sinogram; null where the source shift is zero."
    )
    source_frame: ReportedSourceFrame
    standard_deviation: StandardDeviation | None = Field(description="Null from a method that has no error bars.")
    covariance: list[list[float]] | None = Field(
        description="Of (psi_rad, source_distance_mm, source_to_detector_mm, cor_column_mm, tilt_rad); "
        "the row of a parameter that was held, or that the scan does not determine, is zero."
    )
    theta_covariance: list[list[float]] | None = Field(
        None,
        description="Of (initial_angle_rad, detector_to_cor_mm, source_shift_mm, detector_shift_mm, detector_tilt); "
        "null where the source shift or the first angle is not resolved.",
    )
    unconstrained_source_distance_mm: float = Field(description="R before it was held at source_to_cor_mm, if it was.")
    scale_uncertainty_mm: float = Field(
        description="What R inherits from the phantom's size tolerance: a systematic share."
    )
    scale_ray_error_mm: float = Field(
        description="What the rays inherit from the phantom's size tolerance (RMS, systematic); no residual shows it."
    )
    scale_uncertainty_percent: float | None = Field(
        None,
        description="The image's millimetres are right to this with 95 %: 1.96 times the standard uncertainties of the "
        "phantom's size and of R/SDD, in quadrature, and half the phantom's aspect. "
        "Null: an answer of an earlier version.",
    )
    predicted_ray_error_mm: PredictedRayError | None = Field(description="Null without error bars.")
    handedness: Handedness
    rotation: Rotation
    hypotheses: list[Hypothesis] = Field(description="All that were tried, best first.")
    phantom_position_mm: tuple[float, float]
    gain: float
    offset: float
    residual: Residual
    adjustments: list[str] = Field([], description="What was found in the scan beyond the plain model, and done.")
    status: CalibrationStatus | None = Field(
        None,
        description="How far the answer may be relied on; the verdict is pass only where it is calibrated. "
        "Null: an answer of an earlier version, which did not report it.",
    )
    verdict: Verdict = Field(
        description="pass: the predicted ray error's upper_95 and scale_uncertainty_percent are within the scanner's "
        "tolerances, and nothing speaks against the answer. watch: only the ray error's RMS is, or the scale is not, "
        "or a reason asks for a look. fail: not even the RMS is, or the fit did not converge."
    )
    rays_verdict: Verdict | None = Field(
        None,
        description="The verdict on the rays alone, whether they are right among themselves up to a common scale. "
        "Null: an answer of an earlier version.",
    )
    limits: CalibrationLimits | None = Field(
        None,
        description="What the verdict was held against. Null: an answer of an earlier version, which did not keep it.",
    )
    reasons: list[str]
    scanner: ScannerConstants
    phantom: str
    views: int
    rows: tuple[int, int] = Field(description="First row and the one after the last.")
    search: Search
    timing_s: Timing
    software_version: str
    input_sha256: str
    comparison: Comparison | None = None
    second_witness: SecondWitness | None = Field(
        None,
        description="The log beside the phantom as a second witness for u_c and tilt; null where the scan shows none, "
        "or has fewer than 120 views.",
    )

    @property
    def radius_mm(self) -> float:
        """Of the disc in which ray errors are counted with this geometry, where its scanner names none."""
        predicted = self.predicted_ray_error_mm
        return LARGEST_ASSUMED_LOG_RADIUS_MM if predicted is None else predicted.radius_mm


class CalibrationFile(CalibrationResult):
    """What the command line prints: an answer that belongs to no service."""

    id: str
    state: Literal["succeeded"] = "succeeded"

    @classmethod
    def of(cls, result: CalibrationResult) -> Self:
        """An answer with an id of its own."""
        return cls(id=str(uuid4()), **dict(result))

    @classmethod
    def read(cls, text: str) -> CalibrationResult:
        """The answer in RESULT.json, whether the command line or the service wrote it.

        Raises
        ------
        ValueError
            The text is no JSON object, or not a calibration that succeeded.
        """
        document = json.loads(text)
        if not isinstance(document, dict) or document.get("state") != "succeeded":
            raise ValueError("it is not a calibration that succeeded")
        known = {name: document[name] for name in CalibrationResult.model_fields if name in document}
        return CalibrationResult.model_validate(known)


class CalibrationLinks(Contract):
    """Where its files are."""

    self: str
    job: str
    report: str
    overlay: str
    hdf5: str


class CalibrationHeader(Stamped):
    """What every calibration carries from the moment it was asked for."""

    scanner_id: Identifier
    scan_id: Identifier
    phantom_id: Identifier
    job_id: Identifier
    schedule_id: Identifier | None = None
    options: CalibrationOptions


class CalibrationUnfinished(CalibrationHeader):
    """Waiting, running, or ended without an answer."""

    state: UnfinishedState
    failure: Failure | None = None
    links: CalibrationLinks | None = None


class CalibrationSucceeded(CalibrationHeader, CalibrationResult):
    """With its answer."""

    state: Literal["succeeded"] = "succeeded"
    links: CalibrationLinks | None = None


Calibration = TypeAliasType(
    "Calibration",
    Annotated[
        CalibrationUnfinished | CalibrationSucceeded,
        Field(discriminator="state", description="A calibration as it stands: with its answer once it has succeeded."),
    ],
)


def calibration_from(record: Mapping[str, Any]) -> CalibrationUnfinished | CalibrationSucceeded:
    """Put a stored record together: a result's fields stand beside the header's."""
    header = {name: record[name] for name in (*CalibrationHeader.model_fields, "state")}
    if record["state"] == "succeeded":
        return CalibrationSucceeded.model_validate({**header, **record["result"]})
    return CalibrationUnfinished.model_validate({**header, "failure": record["failure"]})


DECLARATION = AskedKind(
    kind=JobKind.CALIBRATE,
    noun="calibration",
    lighter="ask for fewer rows or views, or for fewer generations of the published search",
    ask=CalibrationAsk,
    options=CalibrationOptions,
    result=CalibrationResult,
    answer=Calibration,
    read=calibration_from,
    links=CalibrationLinks,
    files={"report": "report.png", "overlay": "overlay.png", "hdf5": "result.h5"},
    references=(Reference.SCAN, Reference.PHANTOM),
    is_short=lambda options: options.method is CalibrationMethod.DEFAULT,
    needed_scope=lambda ask: Scope.ACTIVATE if ask.activate else Scope.SUBMIT,
    listed_by=("scanner_id", "state"),
    to_ask=Operation(
        "Ask for a calibration",
        """\
Find theta from a scan of a phantom.

The scan may still be read: the job waits for it. `GET` the calibration, or stream its job's events, until it ends.""",
        {"body": {"scan_id": "example"}},
    ),
    to_list=Operation("List calibrations, newest first", "All of them, or those of one scanner, or in one state."),
    to_get=Operation("Get a calibration", "Its state, and the whole answer once there is one."),
)
