"""Plans: how well a phantom will calibrate a scanner, before it is made."""

from typing import Annotated

from pydantic import Field

from sawmill_worker.contracts.base import Contract, Identifier, Stamped
from sawmill_worker.contracts.calibrations import PredictedRayError, StandardDeviation
from sawmill_worker.contracts.geometry import GivenTheta, ReportedSourceFrame, ScannerConstants
from sawmill_worker.contracts.given import Given
from sawmill_worker.contracts.jobs import Failure, JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, Operation, Reference, stored_as
from sawmill_worker.contracts.phantoms import SizeTolerancePercent
from sawmill_worker.vocabulary import Theta


class PlanOptions(Contract):
    """The scan that is planned, apart from the phantom and the scanner."""

    views: Annotated[int, Field(ge=3, le=3600)] = Field(360, description="Equidistant, over a full turn.")
    noise: Annotated[float, Field(gt=0, le=1)] = Field(
        0.02, description="Standard deviation of the noise against the RMS of the phantom's sinogram."
    )
    size_tolerance_percent: SizeTolerancePercent | None = Field(
        None, description="Relative standard uncertainty of the phantom's size, in per cent. By default its drawing's."
    )


class PlanAsked(PlanOptions):
    """What was asked, as it is kept: an earlier version took what `PlanAsk` refuses."""

    scanner_id: Identifier
    theta: Theta | None = Field(
        None, description="The nominal geometry; null: that of the scanner's active calibration."
    )


class PlanAsk(PlanAsked, Given):
    """Ask what precision a phantom will give on a scanner."""

    theta: GivenTheta | None = Field(
        None, description="The nominal geometry; null: that of the scanner's active calibration."
    )


class PlanResult(Contract):
    """The precision to expect: the Cramér-Rao bound, with position, gain and background of the phantom unknown."""

    theta: Theta
    source_frame: ReportedSourceFrame
    standard_deviation: StandardDeviation
    covariance: list[list[float]] = Field(description="Of (psi, R, SDD, u_c, tau).")
    predicted_ray_error_mm: PredictedRayError = Field(description="From noise alone.")
    scale_uncertainty_mm: float = Field(description="What R inherits from the phantom's size tolerance beside it.")
    scale_ray_error_mm: float = Field(description="RMS ray error from the phantom's size tolerance.")
    scale_uncertainty_percent: float | None = Field(
        None,
        description="The image's millimetres will be right to this with 95 %: from the size tolerance and the noise of "
        "R/SDD. Null: a plan of an earlier version.",
    )
    noise_mm: float = Field(description="The noise's standard deviation, in mm of wood.")
    views_cut_off: int = Field(description="Views whose shadow reaches an end of the detector; 0 is right.")
    phantom: str
    scanner: ScannerConstants
    views: int
    noise: float
    software_version: str


class PlanLinks(Contract):
    """Where it hangs together."""

    self: str
    job: str
    phantom: str


class Plan(Stamped):
    """A plan as it stands."""

    state: JobState
    phantom_id: Identifier
    scanner_id: Identifier
    job_id: Identifier
    options: PlanAsked
    result: PlanResult | None = None
    failure: Failure | None = None
    links: PlanLinks | None = None


DECLARATION = AskedKind(
    kind=JobKind.PLAN,
    noun="plan",
    lighter="ask for fewer views, or draw the phantom with fewer corners",
    ask=PlanAsk,
    options=PlanAsked,
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
The precision that one scan of the phantom will give on a scanner, before the phantom is made.

The geometry is a nominal theta, or that of the scanner's active calibration.""",
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
    to_list=Operation("List plans, newest first", "All of them, or those with one phantom."),
    to_get=Operation(
        "Get a plan", "Its state, and standard deviations and the predicted ray error once they are there."
    ),
)
