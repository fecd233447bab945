"""Reconstructions: the request and the result."""

import re
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator, model_validator
from pydantic.fields import FieldInfo

from sawmill_contracts import kinds
from sawmill_contracts.choices import MetalTreatment, Weighting
from sawmill_contracts.geometry import GivenTheta, PositiveMm
from sawmill_contracts.kinds import AskedKind, JobAnswer, JobLinks, Operation, Reference, stored_as
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.row_ranges import ChosenViews, SteppedRows
from sawmill_platform.contracts.base import LARGEST_NUMBER, Contract, Identifier, Name, OutOfUse, Sha256, link
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.kind_declarations import Schema, bounded, one_of, require, without
from sawmill_vocabulary import (
    LARGEST_MM,
    AlphaRule,
    CoordinateMm,
    FilterName,
    Handedness,
    HardeningHandling,
    MetalHandling,
    PoseHandling,
    Preference,
    ReconstructionMethod,
    Rotation,
    Theta,
)
from sawmill_vocabulary.messages import N_


def _one_number(value: object, info: ValidationInfo) -> object:
    if isinstance(value, list | tuple):
        raise ValueError(f"{info.field_name} must be one number, since pixels are square, not {list(value)}")  # noqa: TRY004 - what pydantic reports
    return value


OneNumber = BeforeValidator(_one_number)
Positive = Annotated[float, Field(gt=0)]
RingWeight = Annotated[float, Field(ge=1e-3, le=1)]

# For clients: a word, or a number from 0 to below 100.
_COUPLING = r"^(auto|none|[0-9]{1,2}(\.[0-9]{1,6})?)$"


def _coupling_as_text(value: object) -> object:
    """Return a coupling as text; a command's flag is a text, whether a word or a number, and JSON may have a number."""
    text = f"{value:.6f}" if isinstance(value, int | float) and not isinstance(value, bool) else value
    if isinstance(text, str) and not re.fullmatch(_COUPLING, text.strip()):
        raise ValueError(f"coupling must be auto, none, or a number from 0 to below 100 as in 0.4, not {text!r:.100}")
    return text


_CouplingGiven = Annotated[str, Field(pattern=_COUPLING)] | Annotated[float, Field(ge=0, lt=100)]
Coupling = Annotated[
    str,
    BeforeValidator(_coupling_as_text, json_schema_input_type=_CouplingGiven),
    Field(
        description="Coupling of neighbouring slices, for `total_variation` and `ring_tv`. `auto`: cross-validation "
        "on slices in the middle chooses whether to couple, and the weight. `none`: each slice is reconstructed "
        "alone. A number is the weight of a difference along the axis relative to one in the plane, no unit, below "
        "100.",
        examples=["auto"],
    ),
]


@dataclass(frozen=True)
class OptionOf:
    """Mark of an option that belongs to some methods: with any other method it must be left out.

    A method's class in `sawmill_tomography` has a field of the same name (docs/understand/adding.md).
    """

    methods: tuple[ReconstructionMethod, ...]

    @classmethod
    def on(cls, field: FieldInfo) -> "OptionOf | None":
        """Return the mark of a field; None for an option of all methods."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), None)


OfFbp = OptionOf((ReconstructionMethod.FBP, ReconstructionMethod.AUTO))
OfAuto = OptionOf((ReconstructionMethod.AUTO,))
OfTikhonov = OptionOf((ReconstructionMethod.TIKHONOV,))
OfCauchyMap = OptionOf((ReconstructionMethod.CAUCHY_MAP,))
OfRingTv = OptionOf((ReconstructionMethod.RING_TV,))
OfTotalVariation = OptionOf((ReconstructionMethod.TOTAL_VARIATION, ReconstructionMethod.RING_TV))
OfEdgePreserving = OptionOf(
    (ReconstructionMethod.CAUCHY_MAP, ReconstructionMethod.TOTAL_VARIATION, ReconstructionMethod.RING_TV)
)

# Requests that an earlier version stored carry its defaults, whatever their method.
EARLIER_DEFAULTS = {"alpha_rule": AlphaRule.DISCREPANCY, "coupling": "none"}


# Bounds of values that are squared and divided by: float32 holds no more. A field of 10 micrometres shows nothing.
_SQUARED = (1e-9, 1e9)
COMPUTABLE = dict.fromkeys(("alpha", "sigma", "beta", "weight"), _SQUARED) | {"field_mm": (1e-2, LARGEST_MM)}


class ReconstructionOptions(Contract):
    """The rows, the grid, the method and its options."""

    # A stored request may hold values that are refused now.
    is_stored: ClassVar[bool] = False

    rows: SteppedRows | None = Field(
        None,
        description="Detector rows to reconstruct, one slice each: A:B, the first included, the last not, or every "
        "STEP-th of them, A:B[:STEP]. Default: all.",
        examples=["0:16"],
    )
    views: Annotated[int, Field(ge=3)] | None = Field(
        None,
        description="Number of views to use: every (total / views)-th, each with its own angle. Default: all.",
        examples=[180],
    )
    method: ReconstructionMethod = Field(
        ReconstructionMethod.AUTO,
        description="`auto` chooses by the scan's views and noise, and by prefer. Default: `auto`, or `fbp` where an "
        "option of `fbp` differs from its default.",
        examples=["auto"],
    )
    prefer: Annotated[Preference, OfAuto] = Field(
        Preference.QUALITY,
        description="Preference of `auto`: quality, the lowest expected error within 100 ms a slice of 256 x 256 "
        "pixels on two cores, if need be from every second or third view; or speed, fbp from 90 views all round.",
        examples=["quality"],
    )
    filter: Annotated[FilterName, OfFbp] = Field(FilterName.HANN, description="Window on the ramp.", examples=["hann"])
    frequency_scaling: Annotated[float, Field(gt=0, le=1), OfFbp] = Field(
        1.0, description="Cut-off as a fraction of the Nyquist frequency, no unit."
    )
    weighting: Annotated[Weighting, OfFbp] = Field(
        "exact", description="`none` is the published pipeline's weighting: no cosine, no distance weight."
    )
    size: Annotated[int, Field(ge=16, le=4096), OneNumber] = Field(256, description="Pixels along each side.")
    field_mm: Annotated[PositiveMm, OneNumber] = Field(400.0, description="Side of the square field.")
    field_centre_mm: tuple[CoordinateMm, CoordinateMm] = Field(
        (0.0, 0.0),
        description="(x, y) of the field's centre, mm; a region of interest need not be centred on the rotation "
        "centre.",
        examples=[[0.0, 0.0]],
    )
    metal: MetalHandling = Field(
        MetalHandling.AUTO,
        description="Treatment of rays through nails and other metal, where their shadows show any. `auto`: "
        "`cauchy_map` leaves these rays out, `total_variation` and `ring_tv` as well, but give those through thin "
        "metal a small weight, less the metal; other methods take values interpolated along the "
        "detector; the metal is put back into the slices. `interpolate`: every method takes interpolated values. "
        "`none`: all rays are used as they are.",
        examples=["auto"],
    )
    hardening: HardeningHandling = Field(
        HardeningHandling.AUTO,
        description="Treatment of beam hardening and scattered radiation that the calibration found. `auto`: both "
        "are taken out of the line integrals before reconstruction. `none`: neither is taken out.",
        examples=["auto"],
    )
    view_poses: PoseHandling = Field(
        PoseHandling.AUTO,
        description="Shift and roll of the log in each view. `auto`: found from the log where the scanner's object "
        "turns between passages. `from-log`: found from the log. `none`: the log stands still in all views, as `fbp` "
        "needs it.",
        examples=["auto"],
    )
    alpha: Annotated[Positive | None, OfTikhonov] = Field(
        None, description="Regularisation weight of `tikhonov`, mm². Default: chosen by alpha_rule.", examples=[40.0]
    )
    alpha_rule: Annotated[AlphaRule, OfTikhonov] = Field(
        AlphaRule.CROSS_VALIDATION, description="Rule by which `tikhonov` chooses alpha.", examples=["cross-validation"]
    )
    sigma: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Standard deviation of a line integral for `cauchy_map`, in the unit of a line integral. "
        "Default: a multiple of the noise in air, chosen by tuning on a synthetic scan of the same log.",
        examples=[0.02],
    )
    beta: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Scale of the differences between neighbouring pixels for `cauchy_map`, in the volume's unit. "
        "Default: chosen with sigma, or a usual share of the wood's attenuation where sigma is given.",
        examples=[0.0004],
    )
    preset: Annotated[Literal["paper"] | None, OfCauchyMap] = Field(
        None,
        description="Published settings (arXiv 2206.14444) of `cauchy_map`, instead of sigma and beta.",
        examples=["paper"],
    )
    weight: Annotated[Positive | None, OfTotalVariation] = Field(
        None,
        description="Weight of the penalty in `total_variation` and `ring_tv`, in 1 / attenuation. Default: chosen by "
        "cross-validation.",
        examples=[0.5],
    )
    ring_weight: Annotated[RingWeight | None, OfRingTv] = Field(
        None,
        description="Weight of a difference across growth rings relative to one along them, for `ring_tv`, no unit: "
        "1 is total variation. Default: chosen by cross-validation.",
        examples=[0.03],
    )
    coupling: Annotated[Coupling, OfTotalVariation] = "auto"
    non_negative: Annotated[bool, OfEdgePreserving] = Field(
        default=True,
        description="Constraint of `cauchy_map`, `total_variation` and `ring_tv`: no attenuation below zero.",
    )
    uncertainty: Annotated[bool, OutOfUse("0.2.0", "2026-11-22", gone_in="0.3.0", instead="leave it out")] = Field(
        default=False, description="Ignored, with a remark: each pixel's standard deviation is no longer computed."
    )

    @field_validator(*COMPUTABLE)
    @classmethod
    def _can_be_computed_with(cls, value: float | None, info: ValidationInfo) -> float | None:
        least, largest = COMPUTABLE[str(info.field_name)]
        if value is None or cls.is_stored or least <= value <= largest:
            return value
        raise ValueError(f"must be from {least:g} to {largest:g}, not {value:g}")

    @model_validator(mode="after")
    def _choose_fbp_by_its_options(self) -> "ReconstructionOptions":
        marks = ((name, field.default, OptionOf.on(field)) for name, field in type(self).model_fields.items())
        if "method" not in self.model_fields_set and any(
            mark is OfFbp and getattr(self, name) != usual for name, usual, mark in marks
        ):
            object.__setattr__(self, "method", ReconstructionMethod.FBP)  # frozen from here on
        return self

    @model_validator(mode="after")
    def _belong_to_the_method(self) -> "ReconstructionOptions":
        for name, field in ReconstructionOptions.model_fields.items():
            mark = OptionOf.on(field)
            if (
                mark is None
                or self.method in mark.methods
                or getattr(self, name) in (field.default, EARLIER_DEFAULTS.get(name))
            ):
                continue
            owners = " or ".join(sorted(mark.methods))
            raise ValueError(
                f"{name} belongs to method {owners}, not {self.method.value}: leave it out or change the method"
            )
        return self

    @model_validator(mode="after")
    def _agree(self) -> "ReconstructionOptions":
        if self.alpha is not None and self.alpha_rule not in {AlphaRule.CROSS_VALIDATION, AlphaRule.DISCREPANCY}:
            raise ValueError("alpha is given, so alpha_rule has nothing to choose: give one of them")
        if self.preset is not None and (self.sigma is not None or self.beta is not None):
            raise ValueError("preset brings its own sigma and beta: give the preset or them")
        return self


class StoredReconstructionOptions(ReconstructionOptions):
    """A request as it is stored: an earlier version accepted values that `ReconstructionRequest` refuses."""

    is_stored: ClassVar[bool] = True

    # Slices were not coupled by an earlier version.
    coupling: Annotated[Coupling, OfTotalVariation] = "none"
    scan_id: Identifier = Field(description="Id of the scan to reconstruct.")
    calibration_id: Identifier | None = Field(
        None, description="Id of the calibration to use. Null: the scanner's active calibration, unless theta is given."
    )
    theta: Theta | None = Field(None, description="Geometry to use instead of a calibration.")
    rotation: Rotation | None = Field(
        None, description="Sense of rotation, with theta: which way the angles count.", examples=["as-given"]
    )
    handedness: Handedness | None = Field(
        None, description="Handedness, with theta: recorded in the result.", examples=["as-drawn"]
    )

    @model_validator(mode="after")
    def _one_geometry(self) -> "StoredReconstructionOptions":
        if self.theta is not None and self.calibration_id is not None:
            raise ValueError("give calibration_id or theta, not both")
        if self.theta is None and (self.rotation is not None or self.handedness is not None):
            raise ValueError("rotation and handedness come with theta; a calibration carries its own")
        return self


def _state_conditions(schema: Schema, ask: type[ReconstructionOptions]) -> None:
    """State in the schema which options go together, as the validators above check them."""
    bounded(schema, COMPUTABLE)
    for name, field in ask.model_fields.items():
        mark = OptionOf.on(field)
        if mark is not None:
            as_left_out = one_of(name, [field.default, EARLIER_DEFAULTS.get(name, field.default)])
            require(schema, name, as_left_out, one_of("method", mark.methods, default=ReconstructionMethod.AUTO))
    rules = one_of(
        "alpha_rule", [AlphaRule.CROSS_VALIDATION, AlphaRule.DISCREPANCY], default=AlphaRule.CROSS_VALIDATION
    )
    require(schema, "alpha", without("alpha"), rules)
    require(schema, "preset", without("preset"), without("sigma", "beta"))
    require(schema, "theta", without("theta"), without("calibration_id"))
    for name in ("rotation", "handedness"):
        require(schema, name, without(name), {"properties": {"theta": {"type": "object"}}, "required": ["theta"]})


class ReconstructionRequest(StoredReconstructionOptions, Given):
    """Request for a reconstruction with a calibration (the scanner's active one unless named) or with a theta."""

    model_config = ConfigDict(json_schema_extra=_state_conditions)

    is_stored: ClassVar[bool] = False

    views: ChosenViews | None = Field(
        None, description=ReconstructionOptions.model_fields["views"].description, examples=[180]
    )
    coupling: Annotated[Coupling, OfTotalVariation] = "auto"
    theta: GivenTheta | None = Field(None, description="Geometry to use instead of a calibration.")


class MetalReport(Contract):
    """Metal that was found in a log, and what was done about it."""

    slices: int = Field(description="Number of slices that show metal.", examples=[3])
    samples: int = Field(
        description="Number of line integrals of these slices whose rays cross metal or pass close to metal.",
        examples=[1200],
    )
    share_of_samples: float = Field(
        description="Share of these line integrals among all of the slices with metal, no unit.", examples=[0.002]
    )
    untreated_slices: int = Field(
        0,
        description="Number of further slices with metal on more rays than may be taken out: all their rays are used "
        "as they are, and a remark reports it.",
    )
    treatment: MetalTreatment = Field(description="Treatment of these rays.", examples=["interpolated"])
    source: str = Field(
        description="Name of the method that treats metal, and where it was published.",
        examples=["linear interpolation (Kalender 1987)"],
    )


class MethodReport(Contract):
    """The method's parameters, and how well its slices explain the data; the median of several slices."""

    name: ReconstructionMethod = Field(
        description="Method used; never `auto`, but the method that `auto` chose.", examples=["fbp"]
    )
    reason: str | None = Field(
        None,
        description="Reason of the choice of `auto`. Null: `auto` was not requested.",
        examples=["360 views all round suffice for fbp"],
    )
    expected_error: float | None = Field(
        None,
        description="Expected relative error of `auto`, no unit: of simulated logs from as many views, with as much "
        "noise. Null where the views do not go all round.",
        examples=[0.08],
    )
    view_step: int = Field(1, description="Step of the views that `auto` chose: every view_step-th was used.")
    noise: float = Field(description="Standard deviation of a line integral, in its unit.", examples=[0.01])
    data_misfit: float | None = Field(
        description="RMS of the residual (A x - y), relative to the noise, no unit: near 1 for an iterative method "
        "with the right geometry, far above where the geometry is wrong. Only rays through the field "
        "count in a region of interest. `fbp` does not fit the data: with the right geometry the value is anything "
        "from 1 to 80, and a remark tells where it shows a wrong geometry; null where the field does not hold "
        "all of the log.",
        examples=[1.04],
    )
    worst_data_misfit: float | None = Field(
        description="The largest `data_misfit` of all slices, no unit; for `fbp`, of five slices. Null where "
        "`data_misfit` is null.",
        examples=[1.2],
    )
    alpha: float | None = Field(
        None, description="Regularisation weight that `tikhonov` used, mm². Null: another method.", examples=[40.0]
    )
    sigma: float | None = Field(
        None,
        description="Standard deviation that `cauchy_map` used, in the unit of a line integral. Null: another method.",
        examples=[0.02],
    )
    beta: float | None = Field(
        None, description="Scale that `cauchy_map` used, in the volume's unit. Null: another method.", examples=[0.0004]
    )
    weight: float | None = Field(
        None,
        description="Weight that `total_variation` or `ring_tv` used, in 1 / attenuation. Null: another method.",
        examples=[0.5],
    )
    ring_weight: float | None = Field(
        None,
        description="Weight across growth rings that `ring_tv` used, no unit: 1 is total variation. Null: another "
        "method, or an earlier version.",
        examples=[0.03],
    )
    coupling: float | None = Field(
        None,
        description="Coupling that `total_variation` or `ring_tv` used: the weight of a difference along the axis "
        "relative to one in the plane, no unit. 0: each slice alone. Null: another method.",
        examples=[0.5],
    )
    knot_10_mm_contrast: float | None = Field(
        None,
        description="Share of its contrast that a knot of 10 mm keeps with these views, this noise and these "
        "weights, no unit: known inserts in the middle slice. Null: neither `total_variation` nor `ring_tv`, a region "
        "of the log, a log below 120 mm, pixels above 3.2 mm, or an earlier version.",
        examples=[0.62],
    )
    knot_20_mm_contrast: float | None = Field(
        None, description="The same of a knot of 20 mm, no unit. Null as for 10 mm.", examples=[0.9]
    )
    metal: MetalReport | None = Field(
        None, description="Metal in the log. Null: none was found, or the search for metal was off."
    )
    unconverged_slices: int = Field(
        0, description="Number of slices that had not converged when the iterations ran out."
    )
    remarks: list[str] = Field(
        [], description="Remarks on the data and the fit.", examples=[["the log leaves the field in 3 slices"]]
    )
    coded_remarks: list[CodedReason] = Field(
        [], description="The remarks as codes and values; empty where an earlier version reconstructed the log."
    )

    @property
    def remarks_with_codes(self) -> list[CodedReason]:
        """The remarks with their codes; without codes where an earlier version reconstructed the log."""
        return CodedReason.all_of(self.coded_remarks, self.remarks)


class ReconstructionResult(Contract):
    """Properties of a reconstructed volume."""

    shape: tuple[int, int, int] = Field(description="Number of values along (slice, x, y).", examples=[[16, 256, 256]])
    pixel_mm: float = Field(description="Side of a pixel, mm.", examples=[1.5625])
    unit: str = Field(description="Unit of the volume's values.", examples=["1/mm"])
    value_range: tuple[float, float] = Field(
        description="0.1 and 99.9 percentile over the volume, in its unit; the second is at most 2.5 times the 97th "
        "percentile, so that metal does not darken the wood.",
        examples=[[0.0, 0.031]],
    )
    theta: Theta | None = Field(
        description="Geometry of the reconstruction. Null: each view has a geometry of its own, from a file."
    )
    rotation: Rotation = Field(description="Sense of rotation, which way the view angles count.", examples=["as-given"])
    handedness: Handedness = Field(
        description="Handedness, from which end the phantom was seen; recorded with the geometry.",
        examples=["as-drawn"],
    )
    views: int = Field(description="Number of views of the scan.", examples=[360])
    fewest_views: int | None = Field(
        None,
        description="Number of views of the slice with the fewest views, where views lost rows. Null: no view lost "
        "rows.",
        examples=[350],
    )
    rows: tuple[int, int] = Field(
        description="Detector rows that were reconstructed: the first one and the one after the last.",
        examples=[[0, 16]],
    )
    row_step: int = Field(1, description="Every row_step-th of the rows is a slice.")
    time_s: float = Field(description="Seconds that the computation took.", examples=[5.3])
    software_version: str = Field(description="Version of the software that computed it.", examples=["0.15.0"])
    input_sha256: Sha256 = Field(description="SHA-256 of the scan's file, in hexadecimal digits.")
    preparation: list[str] = Field(
        [], description="The steps that prepared the scan's data.", examples=[["flat and dark fields were applied"]]
    )
    coded_preparation: list[CodedReason] = Field(
        [], description="The steps as codes and values; empty where an earlier version reconstructed the log."
    )
    method: MethodReport | None = Field(
        None, description="Report of the method. Null for a result of an earlier version, whose method was fbp."
    )
    has_deviation: bool = Field(
        default=False,
        description="Whether each pixel's standard deviation is in the volume, as in results of an earlier version.",
    )

    @property
    def preparation_with_codes(self) -> list[CodedReason]:
        """The steps with their codes; without codes where an earlier version reconstructed the log."""
        return CodedReason.all_of(self.coded_preparation, self.preparation)


class ReconstructionName(Given):
    """Name of a reconstruction, for people."""

    name: Name | None = Field(description="The name. Null: none.", examples=["spruce with a nail"])


# Of one reconstruction: more than a person reads.
MOST_MARKS = 100
Place = tuple[CoordinateMm, CoordinateMm]


class MarkRequest(Given):
    """A ruler or a region in a slice; what it measures follows from its ends."""

    kind: Literal["ruler", "region"] = Field(
        description="`ruler`: the length between the ends. `region`: the values in the ellipse between two corners.",
        examples=["ruler"],
    )
    slice: int = Field(ge=0, le=LARGEST_NUMBER, description="Number of the slice, from 0.", examples=[0])
    ends_mm: tuple[Place, Place] = Field(
        description="(x, y) of both ends or corners, mm; a picture's row is +x, a column +y.",
        examples=[[[-20.0, 0.0], [20.0, 15.0]]],
    )
    note: Name | None = Field(None, description="Words about it, for people. Null: none.", examples=["dead knot"])


class Mark(MarkRequest):
    """A mark that is kept with a reconstruction."""

    id: Identifier = Field(description="Id of the mark, which its client chose.", examples=["knot-1"])


class ReconstructionLinks(JobLinks):
    """Links to a reconstruction's files."""

    volume: str = link("the volume as HDF5", "reconstructions/example/volume.h5")
    volume_tiff: str = link("the volume as a TIFF stack", "reconstructions/example/volume.tif")
    volume_nrrd: str = link("the volume as NRRD", "reconstructions/example/volume.nrrd")
    first_slice: str = link("the picture of the first slice", "reconstructions/example/slices/0.png")
    first_slice_array: str = link("the first slice as an array", "reconstructions/example/slices/0.npy")
    mosaic: str = link("the picture of slices along the log", "reconstructions/example/mosaic.png")
    side: str = link("the picture of the log from the side", "reconstructions/example/side.png")
    side_array: str = link("the side view as an array", "reconstructions/example/side.npy")
    thumbnail: str = link("the small picture", "reconstructions/example/thumbnail.png")


class Reconstruction(JobAnswer[StoredReconstructionOptions, ReconstructionResult, ReconstructionLinks]):
    """A reconstruction and its state."""

    name: Name | None = Field(
        None,
        description="Name that somebody gave it. Null: nobody did, and pages name it by scanner, number and time.",
        examples=["spruce with a nail"],
    )
    number: int = Field(
        description="Number of the log among the scanner's logs, from 1; the reconstructions of one scan share it.",
        examples=[14],
    )
    marks: list[Mark] = Field([], description="Rulers and regions that people keep with it, the oldest first.")
    scanner_id: Identifier = Field(description="Id of the scanner.")
    scan_id: Identifier = Field(description="Id of the scan that is reconstructed.")
    calibration_id: Identifier | None = Field(
        description="Id of the calibration. Null: a theta was given, or a new scanner has none yet."
    )


DECLARATION = AskedKind(
    kind=kinds.RECONSTRUCT,
    noun="reconstruction",
    label=N_("Reconstruction of a log"),
    about="Slices of a log with a calibrated geometry.",
    # A fitted method reports each iteration, and needs fifty or more iterations within its day: half an hour each at
    # most.
    stall_s=2 * 3600,
    ask=ReconstructionRequest,
    options=StoredReconstructionOptions,
    result=ReconstructionResult,
    answer=Reconstruction,
    read=stored_as(Reconstruction),
    links=ReconstructionLinks,
    files={
        "volume": "volume.h5",
        "volume_tiff": "volume.tif",
        "volume_nrrd": "volume.nrrd",
        "first_slice": "slices/0.png",
        "first_slice_array": "slices/0.npy",
        "mosaic": "mosaic.png",
        "side": "side.png",
        "side_array": "side.npy",
        "thumbnail": "thumbnail.png",
    },
    result_file="volume.h5",
    references=(Reference.SCAN, Reference.CALIBRATION),
    listed_by=("scanner_id", "scan_id", "state"),
    to_ask=Operation(
        "Ask for a reconstruction",
        """\
Reconstruct slices of a log, with the scanner's active calibration, another one, or a theta of your own.

The scan may still be read and the calibration still computed: the job waits for them.""",
        {"body": {"scan_id": "example"}},
    ),
    to_list=Operation(
        "List reconstructions, newest first", "All reconstructions, or a selection by scanner, state or span of time."
    ),
    to_get=Operation(
        "Get a reconstruction", "State of the reconstruction, and its shape and range once it has succeeded."
    ),
)
