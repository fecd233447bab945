"""Drift checks: an ordinary log scan against a calibration, without a phantom, and the baselines of later checks."""

from datetime import datetime
from typing import Self

from pydantic import Field

from sawmill_contracts import kinds
from sawmill_contracts.choices import DisturbedPart, DriftMethod, DriftReference
from sawmill_contracts.geometry import Covariance, ScannerConstants
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation, Reference, stored_as
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import Rows
from sawmill_platform.contracts.base import Contract, Identifier, Sha256, Time, link
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import DetectorEstimate, Rotation, Theta
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.uncertainty import ContrastLoss


class DetectorGeometry(Contract):
    """The part of the geometry that a log shows."""

    cor_column_mm: float = Field(
        description="u_c, where the centre of rotation falls on the detector.", examples=[-209.1]
    )
    tilt_rad: float = Field(
        description="tau, tilt of the detector against the ray through the centre of rotation.", examples=[-0.083]
    )
    source_to_detector_mm: float = Field(
        description="SDD along the ray through the centre of rotation; only weakly determined, and held where it is "
        "not determined.",
        examples=[1619.3],
    )


class DetectorDeviation(Contract):
    """Standard deviations, or multiples of them; null for the distance where the scan does not show it."""

    cor_column_mm: float = Field(
        description="Value for u_c, where the centre of rotation falls on the detector, mm, or in standard deviations.",
        examples=[0.05],
    )
    tilt_rad: float = Field(
        description="Value for tau, the detector's tilt, radians, or in standard deviations.", examples=[0.0004]
    )
    source_to_detector_mm: float | None = Field(
        description="Value for SDD, mm, or in standard deviations. Null: the scan does not show it.", examples=[12.0]
    )


class KnownBaseline(Contract):
    """Mean of the first drift checks by one method after a calibration: the zero of later ones."""

    method: DriftMethod = Field(description="Method by which the drift checks compared views.", examples=["view-pairs"])
    checks: int = Field(description="Number of drift checks in the baseline, no unit.", examples=[50])
    outliers: int = Field(
        description="Number of drift checks that were left out of the mean, far from the rest; no unit.", examples=[0]
    )
    first_at: Time | None = Field(
        description="When the first drift check ended. Null: results of the command line without a time.",
        examples=["2026-03-02T05:31:04Z"],
    )
    last_at: Time | None = Field(
        description="When the last drift check ended. Null: results of the command line without a time.",
        examples=["2026-03-02T06:07:00Z"],
    )
    cor_column_offset_mm: float = Field(description="u_c of the zero less the calibrated one, mm.", examples=[0.08])
    tilt_offset_rad: float = Field(description="tau of the zero less the calibrated one, radians.", examples=[-0.0001])
    covariance: Covariance = Field(
        description="Covariance of the zero, (cor_column_mm, tilt_rad), in the products of their units, without the "
        "calibration's.",
        examples=[[[0.0001, 0.0], [0.0, 1e-08]]],
    )

    @property
    def offset(self) -> DetectorEstimate:
        """The zero less the calibrated values, with the zero's own errors."""
        return DetectorEstimate.of((self.cor_column_offset_mm, self.tilt_offset_rad), self.covariance)


class DriftBaseline(KnownBaseline):
    """Zero of a scanner's changes, and the result of a drift check against it."""

    age_hours: float | None = Field(
        None,
        description="Number of hours from the last drift check in the baseline to this one. Null: not known.",
        examples=[31.5],
    )
    ray_offset_mm: float = Field(
        description="RMS distance of the rays between the zero and the calibration, mm, in the log's disc, up to a "
        "common scale; caused by the flat field, the calibration, or a move before these logs.",
        examples=[0.04],
    )
    change: DetectorGeometry = Field(
        description="Measured values less the zero; for the distance, measured less calibrated."
    )
    change_standard_deviation: DetectorDeviation = Field(
        description="Standard deviations of the change, from this scan's errors and the zero's."
    )
    significance: DetectorDeviation = Field(description="Each change in units of its standard deviation.")


class DriftOptions(Contract):
    """The part of the scan that is used."""

    rows: Rows | None = Field(
        None,
        description="Detector rows A:B to average, the first included, the last not. Default: all. A scan that was "
        "posted as the mean of rows has only that mean.",
    )


class StoredDriftOptions(DriftOptions):
    """The part of the scan that is used, and the imported geometry where there was no calibration."""

    theta: Theta | None = Field(
        None, description="The scanner's imported geometry, which was compared. Null: there was a calibration."
    )
    rotation: Rotation | None = Field(
        None, description="Sense of rotation, with theta: which way the angles count.", examples=["as-given"]
    )


class DriftRequest(DriftOptions, Given):
    """Request to find whether a scanner has moved since a calibration. The scan needs 8 views or more, of any log."""

    scan_id: Identifier = Field(description="Id of the scan.")
    calibration_id: Identifier | None = Field(
        None,
        description="Id of the calibration to compare with; null: the scanner's active calibration, else its imported "
        "geometry, which gives a change without a verdict.",
    )


class TurnDisturbance(Contract):
    """A harmonic of the turn itself, fitted with the geometry: neither drift nor part of the change."""

    part: DisturbedPart = Field(
        description="`encoder`: the angles run ahead and behind. `bearing`: the log swings across the beam.",
        examples=["encoder"],
    )
    times_a_turn: int = Field(description="Number of the harmonic's periods a turn.", examples=[1])
    amplitude_deg: float | None = Field(
        None, description="Amplitude of the encoder's error, degrees. Null: the bearing is disturbed.", examples=[0.05]
    )
    amplitude_mm: float | None = Field(
        None,
        description="Amplitude of the bearing's swing across the beam at the centre of rotation, mm. Null: the "
        "encoder is disturbed.",
        examples=[0.3],
    )


class DriftResult(Contract):
    """Result of a drift check: what moved, how surely, and what cannot be seen."""

    measured: DetectorGeometry = Field(description="Measured values of the geometry.")
    standard_deviation: DetectorDeviation = Field(description="Standard deviations of the measured values.")
    covariance: Covariance = Field(
        description="Covariance of the measured values, (cor_column_mm, tilt_rad, source_to_detector_mm), in the "
        "products of their units.",
        examples=[[[0.0025, 0, 0], [0, 1.6e-07, 0], [0, 0, 0]]],
    )
    calibrated: DetectorGeometry = Field(description="The calibration's values.")
    change: DetectorGeometry = Field(
        description="Measured values less calibrated ones, also where there is a baseline."
    )
    change_standard_deviation: DetectorDeviation = Field(
        description="Standard deviations of the change, from this scan's errors and, where known, the calibration's."
    )
    significance: DetectorDeviation = Field(description="Each change in units of its standard deviation.")
    reference: DriftReference = Field(
        "calibration",
        description="Zero of `moved`, `ray_change_mm`, `scale_change_percent`, `within_tolerance` and `reason`: the "
        "baseline where there is one, else the calibration.",
    )
    baseline: DriftBaseline | None = Field(
        None, description="The baseline, which counts as zero, and the change from it. Null: there is no baseline."
    )
    theta: Theta | None = Field(
        None,
        description="The given geometry with u_c and tau as this scan shows them at the given SDD, and the rest as "
        "given. Null: the scan was compared with a calibration.",
        examples=[None],
    )
    moved: bool = Field(
        description="Whether any change is beyond three standard deviations; false where a geometry was given.",
        examples=[False],
    )
    ray_change_mm: float = Field(
        description="RMS distance between the rays inside the log's disc, up to a common scale, with what this scan "
        "cannot see unchanged; a distance of the detector that has not significantly changed is held too. Counted "
        "from `reference`.",
        examples=[0.01],
    )
    ray_change_uncertainty_mm: float = Field(
        description="RMS ray distance that the errors alone bring about.", examples=[0.02]
    )
    contrast_loss: ContrastLoss | None = Field(
        None,
        description="Losses that the change of the rays causes. Null: an answer of an earlier version, or a geometry "
        "was given.",
    )
    scale_change_percent: float | None = Field(
        None,
        description="Change of the image's size, per cent, which the ray change leaves out. Null: an answer of an "
        "earlier version.",
        examples=[0.05],
    )
    scale_change_uncertainty_percent: float | None = Field(
        None, description="95 % uncertainty of the change of scale, per cent.", examples=[0.4]
    )
    radius_mm: float = Field(description="Radius of the disc in which rays are compared, mm.", examples=[150.0])
    tolerance_mm: float = Field(gt=0, description="RMS ray distance up to which nothing moved.", examples=[0.5])
    within_tolerance: bool | None = Field(
        description="False: a change beyond chance moved the rays, or the image's size, by more than is allowed. Null: "
        "the scan is too uncertain to say, or a geometry was given, which has no error bars.",
        examples=[True],
    )
    reason: str = Field(
        description="Meaning of the change: what the log shows, a likely cause and what to do, in English.",
        examples=["A log shows that nothing has moved. Nothing needs to be done."],
    )
    coded_reason: CodedReason | None = Field(
        None,
        description="The reason with its code and values. Null: an answer of an earlier version, or of a geometry that "
        "was given.",
    )
    method: DriftMethod | None = Field(
        None,
        description="How the views were compared. Null: an answer of an earlier version.",
        examples=["opposite-rays"],
    )
    not_seen: list[str] = Field(
        description="Parameters that no scan without a phantom can show.",
        examples=[["R, the distance from the source to the centre of rotation"]],
    )
    rotation: Rotation = Field(description="The sense of rotation in which rays agree.", examples=["as-given"])
    rotation_ratio: float = Field(
        description="Ratio of the rays' disagreement in the other sense of rotation to that in this one, no unit.",
        examples=[60.0],
    )
    rotation_decided: bool = Field(
        description="False: the log is too round and centred to tell; the calibration's rotation is kept.",
        examples=[True],
    )
    relative_residual: float = Field(
        description="RMS difference of opposite rays, relative to what changes with the view; or of sums of pairs "
        "of views, relative to the sums. No unit.",
        examples=[0.01],
    )
    disturbances: list[TurnDisturbance] = Field(
        default_factory=list,
        description="Disturbances of the turn beyond chance. Undetected ones are allowed for in the standard "
        "deviations.",
    )
    encoder_bound_mm: float | None = Field(
        None,
        description="Largest remaining change of `cor_column_mm` of this log from an encoder error of 0.1 degrees "
        "once a turn, either sign, depending on the log's position; the standard deviations include it. Null: "
        "opposite rays were compared, with which an encoder is one of `disturbances`, or an answer of an earlier "
        "version.",
        examples=[0.004],
    )
    adjustments: list[str] = Field(
        default_factory=list,
        description="Adjustments of the scan before its use, a sentence each.",
        examples=[["1 corrupt view was left out"]],
    )
    scanner: ScannerConstants = Field(description="The scanner's constants with which it was computed.")
    views: int = Field(description="Number of views of the scan.", examples=[360])
    rows: tuple[int, int] = Field(
        description="First row and the one after the last; [0, 1] for a scan that was posted as a mean of rows, of "
        "which `adjustments` has the number.",
        examples=[[0, 16]],
    )
    at: Time | None = Field(
        None,
        description="When the drift check ended. Null: an answer of an earlier version.",
        examples=["2026-03-02T05:31:04Z"],
    )
    time_s: float = Field(description="Seconds that the computation took.", examples=[3.2])
    software_version: str = Field(description="Version of the software that computed it.", examples=["0.15.0"])
    input_sha256: Sha256 = Field(description="SHA-256 of the scan's file, in hexadecimal digits.")

    @property
    def explanation(self) -> CodedReason:
        """The reason with its code, or a sentence without one."""
        return self.coded_reason or CodedReason.of(self.reason)

    @property
    def detector_change(self) -> DetectorEstimate:
        """The measured u_c and tau less the calibrated ones, with this scan's own errors."""
        own = [row[:2] for row in self.covariance[:2]]
        return DetectorEstimate.of((self.change.cor_column_mm, self.change.tilt_rad), own)

    def ended(self, at: datetime) -> Self:
        """Return the result with its time of end, and so with its baseline's age."""
        baseline = self.baseline
        if baseline is not None and baseline.last_at is not None:
            baseline = baseline.model_copy(update={"age_hours": (at - baseline.last_at).total_seconds() / 3600.0})
        return self.model_copy(update={"at": at, "baseline": baseline})


class DriftLinks(JobLinks):
    """Links to related resources."""

    calibration: str | None = link(
        "the calibration to compare with; null: an imported geometry", "calibrations/example"
    )


class Drift(JobAnswer[StoredDriftOptions, DriftResult, DriftLinks]):
    """A drift check in its present state."""

    scanner_id: Identifier = Field(description="Id of the scanner.")
    scan_id: Identifier = Field(description="Id of the scan.")
    calibration_id: Identifier | None = Field(
        description="Id of the calibration to compare with; null: the imported geometry."
    )


DECLARATION = AskedKind(
    kind=kinds.DRIFT,
    topic="drift-check",
    noun="drift",
    label=N_("Drift check"),
    about="Changes since a calibration, from a log's scan alone.",
    lighter="ask for fewer rows",
    ask=DriftRequest,
    options=StoredDriftOptions,
    result=DriftResult,
    answer=Drift,
    read=stored_as(Drift),
    links=DriftLinks,
    references=(Reference.SCAN, Reference.CALIBRATION),
    is_short=lambda _: True,
    listed_by=("scanner_id", "scan_id", "state"),
    to_ask=Operation(
        "Check for drift without a phantom",
        """\
Find what moved since a calibration, from any scan of a log with 8 views or more.

In a scan that goes all round in steps of 3 degrees or less every ray is measured twice, from either side. In any other
one the views are compared two by two: weighted sums of their rays must be the same. The agreement shows where the
centre of rotation falls on the detector, and the detector's tilt. The source's distance and the first angle cannot be
seen.
The stack of projections is not needed: the mean of its rows, posted as a scan with `averaged_rows`, is enough.
The scan may still be read and the calibration still computed: the job waits for them.""",
        {"body": {"scan_id": "example"}},
    ),
    to_list=Operation("List drift checks, newest first", "All drift checks, or a selection by scanner, scan or state."),
    to_get=Operation(
        "Get a drift check",
        "State of the drift check, and once it is known what moved, how surely and what to inspect.",
    ),
)
