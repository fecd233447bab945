"""Calibrations: options of the request, and the answer with everything that is known about the geometry."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self
from uuid import uuid4

from pydantic import Field
from typing_extensions import TypeAliasType

from sawmill_contracts import kinds
from sawmill_contracts.choices import (
    Axis,
    PaperCorrelation,
    PaperObjective,
    PaperStop,
    UnfinishedState,
    UsedEstimate,
    Verdict,
    Weighting,
)
from sawmill_contracts.geometry import (
    COVARIANCE_EXAMPLE,
    Covariance,
    PositiveMm,
    ReportedSourceFrame,
    ScannerConstants,
    SourceFrameDeviation,
    ThetaDeviation,
)
from sawmill_contracts.kinds import AskedKind, JobLinks, Operation, Reference
from sawmill_contracts.next_steps import NextStepAnswer
from sawmill_contracts.phantoms import SizeTolerancePercent
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import ChosenViews, Rows
from sawmill_contracts.scanners import Tolerances
from sawmill_platform.contracts.base import Contract, Identifier, Sha256, Stamped, link
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Failure
from sawmill_platform.contracts.keys import Scope
from sawmill_vocabulary import (
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
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.scattered_radiation import BeamCorrection, BeamHardening, ScatteredRadiation
from sawmill_vocabulary.uncertainty import BudgetLine, ContrastLoss


class PaperOptions(Contract):
    """Switches of the published search (arXiv 2206.14444)."""

    objective: PaperObjective = Field("image", description="Correlate FBP images, or compare sinograms.")
    weighting: Weighting = Field("none", description="FBP weights; the published pipeline has none.")
    correlation: PaperCorrelation = Field(
        "unnormalised", description="Correlation of images or sinograms: as published, or normalised."
    )
    stop: PaperStop = Field("published", description="SciPy's default stop, or one that waits for convergence.")
    max_generations: Annotated[int, Field(ge=1, le=10_000)] = Field(
        1000, description="The search ends after this number of generations."
    )
    image_size: Annotated[int, Field(ge=32, le=1024)] = Field(
        256, description="Pixels along each side of the correlated images."
    )


class CalibrationOptions(Contract):
    """Options of a calibration, apart from scan and phantom."""

    rows: Rows | None = Field(
        None,
        description="Detector rows A:B to average, the first included, the last not. Default: the scan's phantom "
        "rows, else the rows in which the phantom is found.",
    )
    log_rows: Rows | None = Field(
        None,
        description="Detector rows A:B that show a log beside the phantom, which gives u_c and tilt too. "
        "Default: the rows in which a log is found.",
        examples=["20:28"],
    )
    views: Annotated[int, Field(ge=3)] | None = Field(
        None,
        description="Number of views to use: every (total / views)-th, each with its own angle. Default: all.",
        examples=[180],
    )
    handedness: Handedness | None = Field(
        None,
        description="Handedness, from which end the phantom was seen. Default: the scanner's, else both are tried.",
        examples=["as-drawn"],
    )
    rotation: Rotation | None = Field(
        None,
        description="Sense of rotation, which way the angles count. Default: the scanner's, else both are tried.",
        examples=["as-given"],
    )
    method: CalibrationMethod = Field(
        CalibrationMethod.DEFAULT, description="The product's own search, or the published one.", examples=["default"]
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = Field(7, description="Seed of the search's random numbers, no unit.")
    rays_per_cell: Annotated[int, Field(ge=1, le=64)] | None = Field(
        None,
        description="Number of rays for each cell in the model. Default: the average over the whole cell, as in a "
        "real detector.",
        examples=[4],
    )
    without: list[Adjustment] = Field(
        [],
        max_length=len(Adjustment),
        description="Corrections of a scan with faults that are left out.",
        examples=[["metal"]],
    )
    size_tolerance_percent: SizeTolerancePercent | None = Field(
        None,
        description="Relative standard uncertainty of the phantom's size, in per cent. Default: that of its drawing, "
        f"or {100 * STANDARD_SIZE_TOLERANCE:g} where the drawing states none.",
        examples=[0.15],
    )
    true_axis: Axis | None = Field(
        None,
        description="Axis of the drawing along which the phantom's size is right. Default: the drawing's, else "
        "neither: half the difference between the two is then added to the scale's uncertainty.",
        examples=["x"],
    )
    paper: PaperOptions = Field(
        PaperOptions(), description="Switches of the published search; ignored by the default method."
    )


class GivenCalibrationOptions(CalibrationOptions, Given):
    """Options of a calibration in a request; an earlier version accepted values that are refused here."""

    views: ChosenViews | None = Field(
        None, description=CalibrationOptions.model_fields["views"].description, examples=[180]
    )


class CalibrationRequest(GivenCalibrationOptions, Given):
    """Ask for a calibration."""

    scan_id: Identifier = Field(description="Id of the scan that shows the phantom.")
    phantom_id: Identifier | None = Field(
        None, description="Id of the phantom in the scan. Null: the one that the scan names.", examples=["l-shape"]
    )
    activate: bool = Field(
        default=False,
        description="Whether the calibration becomes the scanner's active one if its rays_verdict is pass: an "
        "uncertain scale blurs nothing and does not stop it.",
    )


class CalibrationLimits(Contract):
    """Limits of a verdict where no scanner with tolerances is registered."""

    tolerance_mm: PositiveMm = Field(0.1, description="Limit of the predicted ray error, mm.")
    scale_tolerance_percent: Annotated[float, Field(gt=0, le=100)] = Field(
        0.5, description="Limit of the scale uncertainty, per cent."
    )
    log_radius_mm: PositiveMm | None = Field(
        None,
        description="Radius of the disc in which ray errors are counted, mm. Null: radius of the smallest disc that "
        "holds the phantom.",
        examples=[150.0],
    )

    @classmethod
    def of(cls, tolerances: Tolerances, log_radius_mm: float | None = None) -> Self:
        """Return the limits by the tolerances of a scanner, inside the disc of the largest log."""
        of_rays, of_scale = tolerances.predicted_ray_error_mm, tolerances.scale_percent
        return cls(tolerance_mm=of_rays, scale_tolerance_percent=of_scale, log_radius_mm=log_radius_mm)


class StandardDeviation(Contract):
    """Standard deviations of theta and of the source frame."""

    theta: ThetaDeviation = Field(description="Standard deviations of theta.")
    source_frame: SourceFrameDeviation = Field(description="Standard deviations of the source frame.")


_UNKNOWN = StandardDeviation(
    theta=ThetaDeviation.model_validate(dict.fromkeys(ThetaDeviation.model_fields)),
    source_frame=SourceFrameDeviation.model_validate(dict.fromkeys(SourceFrameDeviation.model_fields)),
)


class PredictedRayError(Contract):
    """The ray error that the covariance predicts, inside the log's disc."""

    rms: float = Field(description="Root of the expected mean square over rays and points, mm.", examples=[0.02])
    max: float = Field(description="Standard deviation at the worst point, mm.", examples=[0.05])
    upper_95: float = Field(description="The RMS ray error stays below this, mm, in 95 of 100 cases.", examples=[0.04])
    interval_95: tuple[float, float] | None = Field(
        None,
        description="Two-sided 95 % interval of the RMS ray error, mm. Null: an answer of an earlier version.",
        examples=[[0.012, 0.041]],
    )
    radius_mm: float = Field(description="Radius of the disc in which rays are compared, mm.", examples=[150.0])
    contrast_loss: ContrastLoss | None = Field(
        None, description="Losses that are not exceeded in 95 of 100 cases. Null: an answer of an earlier version."
    )


class Residual(Contract):
    """Misfit of the model to the sinogram."""

    rms: float = Field(description="RMS of the residual, in the unit of the sinogram.", examples=[0.03])
    relative: float = Field(
        description="RMS of the residual against that of the background-free sinogram, no unit.", examples=[0.012]
    )


class Hypothesis(Contract):
    """A hypothesis: one of the four combinations of handedness and sense of rotation."""

    handedness: Handedness = Field(
        description="Handedness of this hypothesis, from which end the phantom is seen.", examples=["as-drawn"]
    )
    rotation: Rotation = Field(
        description="Sense of rotation of this hypothesis, which way the view angles count.", examples=["as-given"]
    )
    relative_residual: float = Field(
        description="RMS of the residual against that of the background-free sinogram, no unit.", examples=[0.012]
    )
    log_likelihood_behind: float | None = Field(
        None,
        description="Logarithmic likelihood of the best hypothesis less this one's, no unit; below 10 the scan does "
        "not decide. Null without error bars.",
        examples=[0.0],
    )


class Search(Contract):
    """The search for the basin of the best fit."""

    method: str = Field(description="The search's name.", examples=["default"])
    seed: int = Field(description="Seed of the search's random numbers, no unit.", examples=[7])
    evaluations: int = Field(description="Number of times that the objective was computed.", examples=[4200])
    generations: int = Field(description="Number of generations of the search.", examples=[60])
    best_value: float = Field(
        description="The objective at the best geometry, in the objective's own unit.", examples=[0.0123]
    )
    converged: bool = Field(description="Whether the search converged.", examples=[True])
    message: str = Field(description="End of the search, in words.", examples=["converged"])


class Timing(Contract):
    """Seconds; total runs from the sinogram in memory to the complete answer."""

    total: float = Field(description="Seconds of all together.", examples=[4.4])
    search: float = Field(description="Seconds of the search.", examples=[2.5])
    refine: float = Field(description="Seconds of the refinement.", examples=[1.2])
    uncertainty: float = Field(description="Seconds of the error bars.", examples=[0.7])


class Comparison(Contract):
    """Change against the scanner's active calibration."""

    calibration_id: Identifier = Field(description="Id of the calibration that was active.")
    ray_change_mm: float = Field(
        description="RMS distance between the two calibrations' rays inside the log's disc, one common rotation and "
        "one common scale taken out.",
        examples=[0.03],
    )
    scale_change_percent: float | None = Field(
        None,
        description="Change of that common scale. Null: an answer of an earlier version, which did not report it.",
        examples=[0.05],
    )
    scale_change_uncertainty_percent: float | None = Field(
        None,
        description="95 % uncertainty of the change of scale, from both covariances; null without error bars.",
        examples=[0.4],
    )
    angle_change_deg: float = Field(description="Change of the first angle.", examples=[0.01])
    cor_column_change_mm: float = Field(
        description="Change of u_c, where the centre of rotation falls on the detector, mm.", examples=[0.02]
    )
    source_distance_change_mm: float = Field(
        description="Change of R, the distance from the source to the centre of rotation, mm.", examples=[0.4]
    )
    tilt_change_deg: float = Field(description="Change of tau, the detector's tilt, degrees.", examples=[0.01])
    tolerance_mm: float | None = Field(
        None, description="Limit of `ray_change_mm`. Null: an answer of an earlier version.", examples=[0.5]
    )
    within_tolerance: bool = Field(
        description="Whether nothing moved beyond the scanner's tolerances.", examples=[True]
    )
    reason: str = Field(
        description="Meaning of the changes, and what to do, in English.",
        examples=["Nothing has moved beyond what is allowed: 0.030 mm, and 0.50 mm is allowed."],
    )
    coded_reason: CodedReason | None = Field(
        None, description="The reason with its code and values. Null: an answer of an earlier version."
    )

    @property
    def explanation(self) -> CodedReason:
        """The reason with its code, or an earlier version's sentence without one."""
        return self.coded_reason or CodedReason.of(self.reason)


class ColumnAndTilt(Contract):
    """Place of the COR on the detector, and tilt: what the phantom's rows and the log's rows both show."""

    cor_column_mm: float = Field(
        description="u_c, where the centre of rotation falls on the detector, mm from its middle.", examples=[-209.1]
    )
    tilt_rad: float = Field(
        description="tau, tilt of the detector against the ray through the centre of rotation, radians.",
        examples=[-0.083],
    )


class LogCheck(Contract):
    """The log next to the phantom: its rows also give u_c and the tilt, by opposite rays or pairs of views."""

    log_rows: tuple[int, int] = Field(
        description="First row that shows the log and the one after the last.", examples=[[20, 28]]
    )
    log_rows_averaged: int = Field(
        description="Number of the log's rows that were averaged, evenly spaced.", examples=[8]
    )
    log: ColumnAndTilt = Field(description="Values from the log's rows.")
    log_standard_deviation: ColumnAndTilt = Field(description="Standard deviations of the values from the log's rows.")
    phantom: ColumnAndTilt = Field(description="Values from the phantom's rows alone.")
    phantom_standard_deviation: ColumnAndTilt = Field(
        description="Standard deviations of the values from the phantom's rows."
    )
    difference: ColumnAndTilt = Field(description="The log's values less the phantom's.")
    difference_standard_deviation: ColumnAndTilt = Field(description="Standard deviations of the difference.")
    reported: ColumnAndTilt = Field(description="Combined values, as in source_frame.")
    reported_standard_deviation: ColumnAndTilt = Field(description="Standard deviations of the combined values.")
    chi_squared: float = Field(
        description="Chi squared of the difference, with 2 degrees of freedom, no unit.", examples=[1.3]
    )
    ray_change_mm: float = Field(
        description="RMS distance between the rays in the log's disc that the difference causes.", examples=[0.03]
    )
    agreement: Agreement = Field(
        description="agree: chi_squared is below 5.99 (95 %). strained: below 13.8 (99.9 %), combined and widened. "
        "disagree: above.",
        examples=["agree"],
    )
    moved: MovedBody | None = Field(
        description="Body that moved during the scan. Null: none did, or the scan does not tell which.",
        examples=["log"],
    )
    used: UsedEstimate = Field(
        description="Source of the reported u_c and tilt; both: combined by their covariances.", examples=["both"]
    )
    log_jump_mm: float | None = Field(
        description="Jump of the log during the scan, from its opposite rays, in noise or beyond it. Null: views in "
        "steps of more than 3 degrees do not show it.",
        examples=[0.02],
    )
    log_jump_view: int | None = Field(
        description="The first view after the jump, counted from 0; null with log_jump_mm.", examples=[131]
    )
    reason: str = Field(description="Meaning of the agreement, in one sentence.", examples=["phantom and log agree"])


class FoundGeometry(Contract):
    """The geometry that was found, with its covariance."""

    theta: Theta = Field(description="The geometry that was found.")
    theta_twin: Theta | None = Field(
        description="The other theta with the same sinogram; null where the source shift is zero."
    )
    source_frame: ReportedSourceFrame = Field(
        description="The geometry with the source on the axis: what the data can see."
    )
    standard_deviation: StandardDeviation | None = Field(
        description="Standard deviations of the geometry. Null from a method that has no error bars."
    )
    covariance: Covariance | None = Field(
        description="Covariance of (psi_rad, source_distance_mm, source_to_detector_mm, cor_column_mm, tilt_rad), in "
        "the products of their units; the row of a parameter that the scan does not determine is zero. Null without "
        "error bars.",
        examples=[COVARIANCE_EXAMPLE],
    )
    theta_covariance: Covariance | None = Field(
        None,
        description="Covariance of (initial_angle_rad, detector_to_cor_mm, source_shift_mm, detector_shift_mm, "
        "detector_tilt), in the products of their units; null where the source shift or the first angle is not "
        "resolved.",
        examples=[
            [[1e-08, 0, 0, 0, 0], [0, 0.12, 0, 0, 0], [0, 0, 0.6, 0, 0], [0, 0, 0, 0.01, 0], [0, 0, 0, 0, 4e-08]]
        ],
    )
    unconstrained_source_distance_mm: float = Field(
        description="R before it was held at source_to_cor_mm; the same as R where it was not held.", examples=[917.1]
    )

    @property
    def deviations(self) -> StandardDeviation:
        """Standard deviations, all of them null from a method that has no error bars."""
        return self.standard_deviation or _UNKNOWN


class Accuracy(Contract):
    """Uncertainties of the image's scale and of the rays."""

    scale_uncertainty_mm: float = Field(
        description="Systematic uncertainty of R, mm, from the phantom's size tolerance.", examples=[1.37]
    )
    scale_ray_error_mm: float = Field(
        description="Systematic uncertainty of the rays (RMS), mm, from the phantom's size tolerance; no residual "
        "shows it.",
        examples=[0.08],
    )
    scale_uncertainty_percent: float | None = Field(
        None,
        description="95 % uncertainty of the image's millimetres, per cent: 1.96 times the standard uncertainties "
        "of the phantom's size and of R/SDD, in quadrature, and half the phantom's aspect. Null: an answer of an "
        "earlier version.",
        examples=[0.3],
    )
    predicted_ray_error_mm: PredictedRayError | None = Field(
        description="Predicted ray error. Null without error bars."
    )

    uncertainty_budget: list[BudgetLine] = Field(
        [], description="Sources of the uncertainty. Empty: no error bars, or an answer of an earlier version."
    )

    @property
    def radius_mm(self) -> float:
        """Radius of the disc, mm, in which ray errors are counted with this geometry, where its scanner names none."""
        predicted = self.predicted_ray_error_mm
        return LARGEST_ASSUMED_LOG_RADIUS_MM if predicted is None else predicted.radius_mm


class PhantomPose(Contract):
    """Pose of the phantom, and the hypotheses that were tried."""

    handedness: Handedness = Field(
        description="Handedness, from which end the phantom was seen.", examples=["as-drawn"]
    )
    rotation: Rotation = Field(description="Sense of rotation, which way the view angles count.", examples=["as-given"])
    hypotheses: list[Hypothesis] = Field(description="All hypotheses that were tried, best first.")
    phantom_position_mm: tuple[float, float] = Field(
        description="Position of the drawing's origin in the image, (x, y) in mm from the centre of rotation.",
        examples=[[3.2, -1.4]],
    )


class PhantomFit(Contract):
    """Fit of the phantom, and corrections of the beam that follow from the fit."""

    gain: float = Field(
        description="Factor between the phantom's model and the sinogram: a line integral for each mm of wood, in "
        "1/mm.",
        examples=[0.021],
    )
    offset: float = Field(
        description="Background of the sinogram: a constant beside the phantom, in the unit of a line integral.",
        examples=[0.003],
    )
    residual: Residual = Field(description="Residual: the sinogram less the model.")
    beam_hardening: BeamHardening | None = Field(
        None,
        description="Beam hardening that was fitted; a reconstruction takes it out of a log's line integrals. Null: "
        "none was found, or an answer of an earlier version.",
    )
    scattered_radiation: ScatteredRadiation | None = Field(
        None,
        description="Scattered radiation that was fitted; a reconstruction takes it out of a log's line integrals. "
        "Null: none was found, or an answer of an earlier version.",
    )

    @property
    def beam(self) -> BeamCorrection:
        """Corrections that a reconstruction applies to a log's line integrals."""
        return BeamCorrection(self.beam_hardening, self.scattered_radiation)


class Judged(Contract):
    """Verdicts with their limits and reasons, and adjustments to faults of the scan."""

    adjustments: list[str] = Field(
        [],
        description="Adjustments: what was found in the scan beyond the plain model, and what was done about it.",
        examples=[["2 corrupt views were left out."]],
    )
    coded_adjustments: list[CodedReason] = Field(
        [], description="The adjustments with their codes and values. Empty: an answer of an earlier version, or none."
    )
    status: CalibrationStatus | None = Field(
        None,
        description="How far the answer may be relied on; the verdict is pass only where it is calibrated. "
        "Null: an answer of an earlier version, which did not report it.",
        examples=["calibrated"],
    )
    verdict: Verdict = Field(
        description="pass: the predicted ray error's upper_95 and scale_uncertainty_percent are within the "
        "scanner's tolerances, and nothing speaks against the answer. watch: only the RMS of the ray error is "
        "within tolerance, or the scale is not, or a reason calls for an inspection. fail: not even the RMS is "
        "within tolerance, or the fit did not converge, or the same cells are wrong in all views.",
        examples=["pass"],
    )
    rays_verdict: Verdict | None = Field(
        None,
        description="The verdict on the rays alone, whether they agree with one another up to a common scale. Null: "
        "an answer of an earlier version.",
        examples=["pass"],
    )
    limits: CalibrationLimits | None = Field(
        None, description="Limits of the verdict. Null: an answer of an earlier version, which did not store them."
    )
    reasons: list[str] = Field(
        description="Reasons why the verdict is not pass, and further remarks, in English, the worst first.",
        examples=[["The source shift is not resolved from 0, so theta has no standard deviations; the rays have."]],
    )
    coded_reasons: list[CodedReason] = Field(
        [], description="The reasons with their codes and values. Empty: an answer of an earlier version, or none."
    )

    @property
    def verdict_on_rays(self) -> Verdict:
        """The verdict on the rays alone; of an earlier version, which did not give it, the whole verdict."""
        return self.rays_verdict or self.verdict

    @property
    def explanations(self) -> list[CodedReason]:
        """The reasons with their codes, or an earlier version's sentences without."""
        return CodedReason.all_of(self.coded_reasons, self.reasons)

    @property
    def findings_in_scan(self) -> list[CodedReason]:
        """The adjustments with their codes, or an earlier version's sentences without."""
        return CodedReason.all_of(self.coded_adjustments, self.adjustments)


class Provenance(Contract):
    """Input, search, time and version of the software from which the answer comes."""

    scanner: ScannerConstants = Field(description="The scanner's constants with which it was computed.")
    phantom: str = Field(description="The phantom's name.", examples=["L-shape"])
    views: int = Field(description="Number of views that were used.", examples=[360])
    rows: tuple[int, int] = Field(
        description="Detector rows that were averaged: the first one and the one after the last.", examples=[[0, 16]]
    )
    search: Search = Field(description="Search for the solution.")
    timing_s: Timing = Field(description="Seconds that the parts of the computation took.")
    software_version: str = Field(description="Version of the software that computed it.", examples=["0.15.0"])
    input_sha256: Sha256 = Field(description="SHA-256 of the scan's file, in hexadecimal digits.")


# Fields are in the order of the bases, from the last base to the first.
class CalibrationResult(Provenance, Judged, PhantomFit, PhantomPose, Accuracy, FoundGeometry):
    """A calibration's answer; also RESULT.json of the command line, which alone is enough to reconstruct."""

    comparison: Comparison | None = Field(
        None, description="Changes since the scanner's active calibration. Null: there was none."
    )
    log_check: LogCheck | None = Field(
        None,
        description="u_c and tilt from the log next to the phantom; null where the scan shows none, "
        "or has fewer than 8 views.",
    )

    @property
    def other_explanations(self) -> list[CodedReason]:
        """The explanations but the scanner's movement, which the comparison has."""
        moved = None if self.comparison is None else self.comparison.reason
        return [each for each in self.explanations if each.sentence != moved]


class CalibrationFile(CalibrationResult):
    """A calibration as the command line prints it, without ids of a service."""

    id: str
    state: Literal["succeeded"] = "succeeded"

    @classmethod
    def of(cls, result: CalibrationResult) -> Self:
        """Give an answer an id."""
        return cls(id=str(uuid4()), **dict(result))

    @classmethod
    def read(cls, text: str) -> CalibrationResult:
        """Read the answer from RESULT.json, whether the command line or the service wrote the file.

        Raises
        ------
        ValueError
            The text is no JSON object, or not a calibration that succeeded.
        """
        document = json.loads(text)
        if not isinstance(document, dict) or document.get("state") != "succeeded":
            raise ValueError("it is not a calibration that succeeded")
        fields = {name: document[name] for name in CalibrationResult.model_fields if name in document}
        return CalibrationResult.model_validate(fields)


class CalibrationLinks(JobLinks):
    """Links to a calibration's files."""

    report: str = link("the report picture", "calibrations/example/report.png")
    overlay: str = link("the picture of the phantom with its outline", "calibrations/example/overlay.png")
    hdf5: str = link("the HDF5 file with every number and array", "calibrations/example/result.h5")


class CalibrationHeader(Stamped):
    """Fields of every calibration, from the request on."""

    scanner_id: Identifier = Field(description="Id of the scanner that is calibrated.")
    scan_id: Identifier = Field(description="Id of the scan that shows the phantom.")
    phantom_id: Identifier = Field(description="Id of the phantom.", examples=["l-shape"])
    job_id: Identifier = Field(description="Id of the job that computes the result.")
    schedule_id: Identifier | None = Field(
        None, description="Id of the schedule that requested it. Null: a person or a program did."
    )
    options: CalibrationOptions = Field(description="Options of the request, apart from the scan and the phantom.")


class CalibrationUnfinished(CalibrationHeader):
    """A calibration that is waiting, running, or ended without an answer."""

    state: UnfinishedState = Field(description="State of the job.", examples=["queued"])
    failure: Failure | None = Field(None, description="Reason of the failure. Null: the job has not failed.")
    links: CalibrationLinks | None = Field(None, description="Links to the calibration and its files.")


class CalibrationSucceeded(CalibrationHeader, CalibrationResult):
    """A calibration with its answer."""

    state: Literal["succeeded"] = Field(
        "succeeded", description="State of the job, which has succeeded.", examples=["succeeded"]
    )
    next_step: NextStepAnswer | None = Field(
        None,
        description="Next step of a person with this calibration, by its own numbers and before anybody decides about "
        "it: its button is `scan-again` after a phantom slipped, also where `verdict` is `pass`. The route `next-step` "
        "takes the state of the scanner into account too. Null: only where a job reads the calibration.",
    )
    links: CalibrationLinks | None = Field(None, description="Links to the calibration and its files.")


Calibration = TypeAliasType(
    "Calibration",
    Annotated[
        CalibrationUnfinished | CalibrationSucceeded,
        Field(
            discriminator="state",
            description="A calibration in its present state: with its answer once it has succeeded.",
        ),
    ],
)


def calibration_from(record: Mapping[str, Any]) -> CalibrationUnfinished | CalibrationSucceeded:
    """Build a calibration from a stored record, in which a result's fields are next to the header's."""
    header = {name: record[name] for name in (*CalibrationHeader.model_fields, "state")}
    if record["state"] == "succeeded":
        return CalibrationSucceeded.model_validate({**header, **record["result"]})
    return CalibrationUnfinished.model_validate({**header, "failure": record["failure"]})


DECLARATION = AskedKind(
    kind=kinds.CALIBRATE,
    topic="calibration",
    noun="calibration",
    label=N_("Calibration"),
    about="Theta from a scan of a phantom, with everything known about it.",
    lighter="ask for fewer rows or views, or for fewer generations of the published search",
    ask=CalibrationRequest,
    options=CalibrationOptions,
    result=CalibrationResult,
    answer=Calibration,
    read=calibration_from,
    links=CalibrationLinks,
    files={"report": "report.png", "overlay": "overlay.png", "hdf5": "result.h5"},
    result_file="result.h5",
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
    to_list=Operation("List calibrations, newest first", "All calibrations, or a selection by scanner or by state."),
    to_get=Operation("Get a calibration", "State of the calibration, and the whole answer once there is one."),
)
