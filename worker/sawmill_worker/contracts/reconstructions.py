"""Reconstructions: the request and the result."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator
from pydantic.fields import FieldInfo

from sawmill_worker.contracts.base import Contract, Identifier, PositiveMm, Stamped, SteppedRows
from sawmill_worker.contracts.choices import MetalTreatment, Weighting
from sawmill_worker.contracts.geometry import GivenTheta
from sawmill_worker.contracts.given import Given
from sawmill_worker.contracts.jobs import Failure, JobKind, JobState
from sawmill_worker.contracts.kinds import AskedKind, Operation, Reference, stored_as
from sawmill_worker.vocabulary import (
    LARGEST_MM,
    AlphaRule,
    CoordinateMm,
    FilterName,
    Handedness,
    MetalHandling,
    Preference,
    ReconstructionMethod,
    Rotation,
    Theta,
)


def _one_number(value: object, info: ValidationInfo) -> object:
    if isinstance(value, list | tuple):
        msg = f"{info.field_name} must be one number, since pixels are square, not {list(value)}"
        raise ValueError(msg)  # noqa: TRY004 - what pydantic reports
    return value


OneNumber = BeforeValidator(_one_number)
Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True)
class OptionOf:
    """Marks an option that belongs to some methods: with any other it must be left out.

    A method's class in `sawmill_worker.tomography` has a field of the same name (docs/adding.md).
    """

    methods: tuple[ReconstructionMethod, ...]

    @classmethod
    def on(cls, field: FieldInfo) -> "OptionOf | None":
        """The mark of a field; None for an option of all methods."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), None)


OfFbp = OptionOf((ReconstructionMethod.FBP, ReconstructionMethod.AUTO))
OfAuto = OptionOf((ReconstructionMethod.AUTO,))
OfTikhonov = OptionOf((ReconstructionMethod.TIKHONOV,))
OfCauchyMap = OptionOf((ReconstructionMethod.CAUCHY_MAP,))
OfTotalVariation = OptionOf((ReconstructionMethod.TOTAL_VARIATION,))
OfEdgePreserving = OptionOf((ReconstructionMethod.CAUCHY_MAP, ReconstructionMethod.TOTAL_VARIATION))

# Requests that an earlier version stored carry its defaults, whatever their method.
EARLIER_DEFAULTS = {"alpha_rule": AlphaRule.DISCREPANCY}


# Of what is squared and divided by: float32 holds no more. A field of 10 micrometres shows nothing.
_SQUARED = (1e-9, 1e9)
COMPUTABLE = dict.fromkeys(("alpha", "sigma", "beta", "weight"), _SQUARED) | {"field_mm": (1e-2, LARGEST_MM)}


class ReconstructionOptions(Contract):
    """The rows, the grid, the method and its options."""

    # A stored request may hold what is refused now.
    is_stored: ClassVar[bool] = False

    rows: SteppedRows | None = Field(
        None,
        description="Detector rows to reconstruct, one slice each: A:B, the first included, the last not, or every "
        "STEP-th of them, A:B[:STEP]. By default all.",
    )
    views: Annotated[int, Field(ge=3)] | None = Field(
        None, description="Use every (total / views)-th view, each with its own angle. By default all."
    )
    method: ReconstructionMethod = Field(
        ReconstructionMethod.FBP, description="`auto` chooses by the scan's views and noise, and by prefer."
    )
    prefer: Annotated[Preference, OfAuto] = Field(
        Preference.QUALITY,
        description="Of `auto`: quality, the lowest expected error within 100 ms a slice of 256 x 256 pixels on two "
        "cores, if need be from every second or third view; or speed, fbp from 90 views all round.",
    )
    filter: Annotated[FilterName, OfFbp] = Field(FilterName.HANN, description="Window on the ramp.")
    frequency_scaling: Annotated[float, Field(gt=0, le=1), OfFbp] = Field(
        1.0, description="Cut-off as a fraction of the Nyquist frequency."
    )
    weighting: Annotated[Weighting, OfFbp] = Field(
        "exact", description="`none` is the published pipeline's: no cosine, no distance weight."
    )
    size: Annotated[int, Field(ge=16, le=4096), OneNumber] = Field(256, description="Pixels along each side.")
    field_mm: Annotated[PositiveMm, OneNumber] = Field(400.0, description="Side of the square field.")
    field_centre_mm: tuple[CoordinateMm, CoordinateMm] = Field(
        (0.0, 0.0),
        description="(x, y) of the field's centre; that of a region of interest is not the rotation centre.",
    )
    metal: MetalHandling = Field(
        MetalHandling.AUTO,
        description="Rays through nails and other metal, where a first image shows any. `auto`: `cauchy_map` and "
        "`total_variation` leave them out, other methods take values interpolated along the detector; the metal is "
        "put back into the slices. `interpolate`: every method does. `none`: all rays as they are.",
    )
    alpha: Annotated[Positive | None, OfTikhonov] = Field(
        None, description="Of `tikhonov`: regularisation weight, in mm². By default chosen by alpha_rule."
    )
    alpha_rule: Annotated[AlphaRule, OfTikhonov] = Field(
        AlphaRule.CROSS_VALIDATION, description="How `tikhonov` chooses alpha."
    )
    sigma: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Of `cauchy_map`: standard deviation of a line integral, in its unit. By default a multiple of "
        "the noise in air, chosen by tuning on a synthetic scan of the same log.",
    )
    beta: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Of `cauchy_map`: scale of the differences between neighbouring pixels, in the volume's unit. "
        "By default chosen with sigma, or a usual share of the wood's attenuation where sigma is given.",
    )
    preset: Annotated[Literal["paper"] | None, OfCauchyMap] = Field(
        None, description="Of `cauchy_map`: the published settings (arXiv 2206.14444), instead of sigma and beta."
    )
    weight: Annotated[Positive | None, OfTotalVariation] = Field(
        None, description="Of `total_variation`, in 1 / attenuation. By default chosen by cross-validation."
    )
    non_negative: Annotated[bool, OfEdgePreserving] = Field(
        default=True, description="Of `cauchy_map` and `total_variation`: no attenuation below zero."
    )
    uncertainty: bool = Field(
        default=False, description="Ignored, with a remark: each pixel's standard deviation is no longer computed."
    )

    @model_validator(mode="after")
    def _can_be_computed_with(self) -> "ReconstructionOptions":
        for name, (least, largest) in {} if self.is_stored else COMPUTABLE.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= largest:
                msg = f"{name} must be from {least:g} to {largest:g}, not {value:g}"
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _belong_to_the_method(self) -> "ReconstructionOptions":
        for name, field in type(self).model_fields.items():
            mark = OptionOf.on(field)
            if (
                mark is None
                or self.method in mark.methods
                or getattr(self, name) in (field.default, EARLIER_DEFAULTS.get(name))
            ):
                continue
            owners = " or ".join(sorted(mark.methods))
            msg = f"{name} belongs to method {owners}, not {self.method.value}: leave it out or change the method"
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _agree(self) -> "ReconstructionOptions":
        if self.alpha is not None and self.alpha_rule not in {AlphaRule.CROSS_VALIDATION, AlphaRule.DISCREPANCY}:
            msg = "alpha is given, so alpha_rule has nothing to choose: give one of them"
            raise ValueError(msg)
        if self.preset is not None and (self.sigma is not None or self.beta is not None):
            msg = "preset brings its own sigma and beta: give the preset or them"
            raise ValueError(msg)
        return self


class ReconstructionAsked(ReconstructionOptions):
    """A request as it is stored: an earlier version accepted values that `ReconstructionAsk` refuses."""

    is_stored: ClassVar[bool] = True

    scan_id: Identifier = Field(examples=["example"])
    calibration_id: Identifier | None = Field(
        None, description="Null: the scanner's active calibration, unless theta is given."
    )
    theta: Theta | None = Field(None, description="A geometry of your own, instead of a calibration.")
    rotation: Rotation | None = Field(None, description="With theta: which way the angles count.")
    handedness: Handedness | None = Field(None, description="With theta: recorded in the result.")

    @model_validator(mode="after")
    def _one_geometry(self) -> "ReconstructionAsked":
        if self.theta is not None and self.calibration_id is not None:
            msg = "give calibration_id or theta, not both"
            raise ValueError(msg)
        if self.theta is None and (self.rotation is not None or self.handedness is not None):
            msg = "rotation and handedness come with theta; a calibration carries its own"
            raise ValueError(msg)
        return self


class ReconstructionAsk(ReconstructionAsked, Given):
    """Ask for a reconstruction with a calibration (the scanner's active one unless named) or with a theta."""

    is_stored: ClassVar[bool] = False

    theta: GivenTheta | None = Field(None, description="A geometry of your own, instead of a calibration.")


class MetalReport(Contract):
    """Metal that was found in a log, and what was done about it."""

    slices: int = Field(description="Slices that show metal.")
    samples: int = Field(description="Line integrals of these slices whose rays cross metal or pass beside it.")
    share_of_samples: float = Field(description="Of all line integrals of these slices.")
    treatment: MetalTreatment
    source: str = Field(description="The name of the method that deals with them, and where it was published.")


class MethodReport(Contract):
    """The method's parameters, and how well its slices explain the data. Of several slices, the median."""

    name: ReconstructionMethod = Field(description="The method used; never `auto`, but the one that it chose.")
    reason: str | None = Field(None, description="Why `auto` chose it.")
    expected_error: float | None = Field(
        None,
        description="With `auto`: the relative error of simulated logs from as many views, with as much noise. Null "
        "where the views do not go all round.",
    )
    view_step: int = Field(1, description="With `auto`: every view_step-th of the views was used.")
    noise: float = Field(description="Standard deviation of a line integral, in its unit.")
    data_misfit: float | None = Field(
        description="RMS of the residual (A x - y), relative to the noise: near 1 for an iterative method with the "
        "right geometry, far above where the geometry is wrong. `fbp` does not fit the data: with the right geometry "
        "anything from 1 to 80, and a remark where it shows a wrong one. Null where the field does not hold all of "
        "the log."
    )
    worst_data_misfit: float | None = Field(description="Of all slices; for `fbp`, of five.")
    alpha: float | None = Field(None, description="Used by `tikhonov`, in mm².")
    sigma: float | None = Field(None, description="Used by `cauchy_map`, in the unit of a line integral.")
    beta: float | None = Field(None, description="Used by `cauchy_map`, in the volume's unit.")
    weight: float | None = Field(None, description="Used by `total_variation`, in 1 / attenuation.")
    metal: MetalReport | None = Field(None, description="Null: none was found, or it was not looked for.")
    unconverged_slices: int = Field(0, description="Slices that had not converged when the iterations ran out.")
    remarks: list[str] = Field([], description="What to know of the data and the fit.")


class ReconstructionResult(Contract):
    """The result beside the volume."""

    shape: tuple[int, int, int] = Field(description="(slice, x, y)")
    pixel_mm: float
    unit: str
    value_range: tuple[float, float] = Field(description="0.1 and 99.9 percentile over the volume.")
    theta: Theta
    rotation: Rotation
    handedness: Handedness
    views: int
    fewest_views: int | None = Field(None, description="Of the slice that fewest views show, where views lost rows.")
    rows: tuple[int, int]
    row_step: int = Field(1, description="Every row_step-th of the rows is a slice.")
    time_s: float
    software_version: str
    input_sha256: str
    preparation: list[str] = Field([], description="The steps that prepared the scan's data.")
    method: MethodReport | None = Field(
        None, description="Null for a result of an earlier version, whose method was fbp."
    )
    has_deviation: bool = Field(
        default=False, description="Of an earlier version's result: each pixel's standard deviation is in the volume."
    )


class ReconstructionLinks(Contract):
    """Links to its files."""

    self: str
    job: str
    volume: str
    first_slice: str
    first_slice_array: str
    mosaic: str
    side: str
    side_array: str
    thumbnail: str


class Reconstruction(Stamped):
    """A reconstruction and its state."""

    state: JobState
    scanner_id: Identifier
    scan_id: Identifier
    calibration_id: Identifier | None
    job_id: Identifier
    options: ReconstructionAsked
    result: ReconstructionResult | None = None
    failure: Failure | None = None
    links: ReconstructionLinks | None = None


DECLARATION = AskedKind(
    kind=JobKind.RECONSTRUCT,
    noun="reconstruction",
    # A fitted method reports each iteration, and needs fifty or more of them within its day: half an hour at most.
    stall_s=2 * 3600,
    ask=ReconstructionAsk,
    options=ReconstructionAsked,
    result=ReconstructionResult,
    answer=Reconstruction,
    read=stored_as(Reconstruction),
    links=ReconstructionLinks,
    files={
        "volume": "volume.h5",
        "first_slice": "slices/0.png",
        "first_slice_array": "slices/0.npy",
        "mosaic": "mosaic.png",
        "side": "side.png",
        "side_array": "side.npy",
        "thumbnail": "thumbnail.png",
    },
    references=(Reference.SCAN, Reference.CALIBRATION),
    listed_by=("scanner_id", "scan_id", "state"),
    to_ask=Operation(
        "Ask for a reconstruction",
        """\
Slices of a log, with the scanner's active calibration, another one, or a theta of your own.

The scan may still be read and the calibration still computed: the job waits for them.""",
        {"body": {"scan_id": "example"}},
    ),
    to_list=Operation(
        "List reconstructions, newest first",
        "All of them, or those of one scanner, in one state, or of a span of time.",
    ),
    to_get=Operation("Get a reconstruction", "Its state, and its shape and range once it is there."),
)
