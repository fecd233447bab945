"""Plans: how well a phantom will calibrate a scanner; and differences between calibrations against their error bars."""

from typing import Annotated, Literal

from pydantic import Field

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import PredictedRayError, StandardDeviation
from sawmill_contracts.geometry import COVARIANCE_EXAMPLE, Covariance, GivenTheta, ReportedSourceFrame, ScannerConstants
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation, Reference, stored_as
from sawmill_contracts.phantoms import SizeTolerancePercent
from sawmill_platform.contracts.base import Contract, Identifier, link
from sawmill_platform.contracts.given import Given
from sawmill_vocabulary import Theta
from sawmill_vocabulary.messages import N_


class PlanOptions(Contract):
    """The planned scan, apart from the phantom and the scanner."""

    views: Annotated[int, Field(ge=3, le=3600)] = Field(
        360, description="Number of views, equidistant over a full turn."
    )
    noise: Annotated[float, Field(gt=0, le=1)] = Field(
        0.02, description="Standard deviation of the noise against the RMS of the phantom's sinogram, no unit."
    )
    size_tolerance_percent: SizeTolerancePercent | None = Field(
        None,
        description="Relative standard uncertainty of the phantom's size, in per cent. Default: that of its drawing.",
        examples=[0.15],
    )


class StoredPlanOptions(PlanOptions):
    """Request of a plan as it is stored: an earlier version accepted what `PlanRequest` refuses."""

    scanner_id: Identifier = Field(description="Id of the scanner that is to be calibrated.")
    theta: Theta | None = Field(
        None, description="Nominal geometry; null: the theta of the scanner's active calibration."
    )


class PlanRequest(StoredPlanOptions, Given):
    """Request for the precision that a phantom will give on a scanner."""

    theta: GivenTheta | None = Field(
        None, description="Nominal geometry; null: the theta of the scanner's active calibration."
    )


class PlanResult(Contract):
    """Expected precision: the Cramér-Rao bound, with position, gain and background of the phantom unknown."""

    theta: Theta = Field(description="Geometry of the plan.")
    source_frame: ReportedSourceFrame = Field(description="The geometry with the source on the axis.")
    standard_deviation: StandardDeviation = Field(description="Expected standard deviations from one scan.")
    covariance: Covariance = Field(
        description="Covariance of (psi, R, SDD, u_c, tau) in rad and mm, in the products of their units.",
        examples=[COVARIANCE_EXAMPLE],
    )
    predicted_ray_error_mm: PredictedRayError = Field(description="Predicted ray error, from noise alone.")
    scale_uncertainty_mm: float = Field(
        description="Systematic uncertainty of R, mm, from the phantom's size tolerance, besides that from noise.",
        examples=[1.37],
    )
    scale_ray_error_mm: float = Field(description="RMS ray error from the phantom's size tolerance.", examples=[0.08])
    scale_uncertainty_percent: float | None = Field(
        None,
        description="Expected 95 % uncertainty of the image's millimetres, per cent: from the size tolerance and "
        "the noise of R/SDD. Null: a plan of an earlier version.",
        examples=[0.3],
    )
    noise_mm: float = Field(description="The noise's standard deviation, in mm of wood.", examples=[2.1])
    views_cut_off: int = Field(
        description="Number of views whose shadow reaches an end of the detector; 0 is right.", examples=[0]
    )
    phantom: str = Field(description="The phantom's name.", examples=["L-shape"])
    scanner: ScannerConstants = Field(description="The scanner's constants with which it was computed.")
    views: int = Field(description="Number of views that are planned.", examples=[360])
    noise: float = Field(
        description="Standard deviation of the noise against the RMS of the phantom's sinogram, no unit.",
        examples=[0.02],
    )
    software_version: str = Field(description="Version of the software that computed it.", examples=["0.15.0"])


class PlanLinks(JobLinks):
    """Links to related resources."""

    phantom: str = link("the phantom", "phantoms/l-shape")


class Plan(JobAnswer[StoredPlanOptions, PlanResult, PlanLinks]):
    """A plan in its present state."""

    phantom_id: Identifier = Field(description="Id of the phantom.", examples=["l-shape"])
    scanner_id: Identifier = Field(description="Id of the scanner.")


DECLARATION = AskedKind(
    kind=kinds.PLAN,
    noun="plan",
    label=N_("Plan of a calibration"),
    lighter="ask for fewer views, or draw the phantom with fewer corners",
    ask=PlanRequest,
    options=StoredPlanOptions,
    result=PlanResult,
    answer=Plan,
    read=stored_as(Plan),
    links=PlanLinks,
    references=(Reference.PHANTOM, Reference.SCANNER, Reference.THETA),
    is_short=lambda _: True,
    blocks_deletion=False,
    listed_by=("phantom_id",),
    asked_at="/v1/phantoms/{phantom_id}/plans",
    tag="phantoms",
    to_ask=Operation(
        "Plan a calibration with a phantom",
        """\
Predict the precision that one scan of the phantom will give on a scanner, before the phantom is made.

The geometry is a nominal theta, or the theta of the scanner's active calibration.""",
        {
            "phantom_id": "l-shape",
            "body": {
                "scanner_id": "example",
                "views": 20,
                "noise": 0.02,
                "theta": {
                    "initial_angle_rad": 0.0,
                    "detector_to_cor_mm": 740.0,
                    "source_shift_mm": 200.0,
                    "detector_shift_mm": 30.0,
                    "detector_tilt": 0.2,
                },
            },
        },
    ),
    to_list=Operation("List plans, newest first", "All plans, or those with one phantom."),
    to_get=Operation(
        "Get a plan", "State of the plan, and once it has succeeded standard deviations and the predicted ray error."
    ),
)


class PairDifference(Contract):
    """Difference of a pair: the second calibration less the first."""

    first: str
    second: str
    ray_difference_mm: float = Field(
        description="RMS distance between the rays inside the log's disc, up to one common rotation and scale."
    )
    expected_95_mm: float = Field(
        description="Upper 95 % limit of the ray difference by both error bars, for this pair alone."
    )
    allowed_mm: float = Field(
        description="Limit of the ray difference by the error bars of all pairs and their scales, 95 %."
    )
    scale_difference_percent: float
    scale_difference_deviation_percent: float = Field(
        description="Standard deviation from noise alone: the phantom's size is common to both."
    )
    scale_allowed_percent: float = Field(
        description="Limit of the difference of scale, as `allowed_mm` is of the ray difference."
    )
    cor_column_difference_mm: float
    cor_column_deviation_mm: float
    tilt_difference_deg: float
    tilt_deviation_deg: float
    within_error_bars: bool = Field(
        description="Whether the rays are within `allowed_mm` and the scale within `scale_allowed_percent`."
    )


class RepeatabilityResult(Contract):
    """Differences of all pairs of some calibrations of one scanner."""

    pairs: list[PairDifference]
    worst_ray_difference_mm: float
    verdict: Literal["repeatable", "beyond-error-bars"]
    reason: str
