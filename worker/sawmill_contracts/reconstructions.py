"""Reconstructions: the request and the result."""

import re
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator, model_validator
from pydantic.fields import FieldInfo

from sawmill_contracts import job_kinds
from sawmill_contracts.choices import MetalTreatment, Weighting
from sawmill_contracts.geometry import GivenTheta
from sawmill_contracts.kinds import AskedKind, Operation, Reference, stored_as
from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import ChosenViews, Contract, Identifier, PositiveMm, Stamped, SteppedRows
from sawmill_platform.contracts.conditions import Schema, bounded, one_of, require, without
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.jobs import Failure, JobState
from sawmill_platform.contracts.old_names import OutOfUse
from sawmill_vocabulary import (
    LARGEST_MM,
    AlphaRule,
    CoordinateMm,
    FilterName,
    Handedness,
    HardeningHandling,
    MetalHandling,
    Preference,
    ReconstructionMethod,
    Rotation,
    Theta,
)
from sawmill_vocabulary.texts import N_


def _one_number(value: object, info: ValidationInfo) -> object:
    if isinstance(value, list | tuple):
        msg = f"{info.field_name} must be one number, since pixels are square, not {list(value)}"
        raise ValueError(msg)  # noqa: TRY004 - what pydantic reports
    return value


OneNumber = BeforeValidator(_one_number)
Positive = Annotated[float, Field(gt=0)]


def _coupling_as_text(value: object) -> object:
    """A command's flag is one text, whether a word or a number; JSON may have the number as itself."""
    text = f"{value:.6f}" if isinstance(value, int | float) and not isinstance(value, bool) else value
    if isinstance(text, str) and not re.fullmatch(patterns.COUPLING, text.strip()):
        msg = f"coupling must be auto, none, or a number from 0 to below 100 as in 0.4, not {text!r:.100}"
        raise ValueError(msg)
    return text


_CouplingGiven = Annotated[str, Field(pattern=patterns.COUPLING)] | Annotated[float, Field(ge=0, lt=100)]
Coupling = Annotated[
    str,
    BeforeValidator(_coupling_as_text, json_schema_input_type=_CouplingGiven),
    Field(
        description="Of `total_variation`: how neighbouring slices help each other. `auto` chooses it, and whether at "
        "all, by cross-validation on slices in the middle. `none`: each slice by itself. A number is the weight of a "
        "difference along the axis relative to one in the plane, no unit, below 100.",
        examples=["auto"],
    ),
]


@dataclass(frozen=True)
class OptionOf:
    """Marks an option that belongs to some methods: with any other it must be left out.

    A method's class in `sawmill_tomography` has a field of the same name (docs/adding.md).
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
EARLIER_DEFAULTS = {"alpha_rule": AlphaRule.DISCREPANCY, "coupling": "none"}


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
        examples=["0:16"],
    )
    views: Annotated[int, Field(ge=3)] | None = Field(
        None,
        description="Number of views to use: every (total / views)-th, each with its own angle. By default all.",
        examples=[180],
    )
    method: ReconstructionMethod = Field(
        ReconstructionMethod.FBP,
        description="`auto` chooses by the scan's views and noise, and by prefer.",
        examples=["fbp"],
    )
    prefer: Annotated[Preference, OfAuto] = Field(
        Preference.QUALITY,
        description="Of `auto`: quality, the lowest expected error within 100 ms a slice of 256 x 256 pixels on two "
        "cores, if need be from every second or third view; or speed, fbp from 90 views all round.",
        examples=["quality"],
    )
    filter: Annotated[FilterName, OfFbp] = Field(FilterName.HANN, description="Window on the ramp.", examples=["hann"])
    frequency_scaling: Annotated[float, Field(gt=0, le=1), OfFbp] = Field(
        1.0, description="Cut-off as a fraction of the Nyquist frequency, no unit.", examples=[1.0]
    )
    weighting: Annotated[Weighting, OfFbp] = Field(
        "exact", description="`none` is the published pipeline's: no cosine, no distance weight.", examples=["exact"]
    )
    size: Annotated[int, Field(ge=16, le=4096), OneNumber] = Field(
        256, description="Pixels along each side.", examples=[256]
    )
    field_mm: Annotated[PositiveMm, OneNumber] = Field(400.0, description="Side of the square field.", examples=[400.0])
    field_centre_mm: tuple[CoordinateMm, CoordinateMm] = Field(
        (0.0, 0.0),
        description="(x, y) of the field's centre; that of a region of interest is not the rotation centre.",
        examples=[[0.0, 0.0]],
    )
    metal: MetalHandling = Field(
        MetalHandling.AUTO,
        description="Rays through nails and other metal, where a first image shows any. `auto`: `cauchy_map` and "
        "`total_variation` leave them out, other methods take values interpolated along the detector; the metal is "
        "put back into the slices. `interpolate`: every method does. `none`: all rays as they are.",
        examples=["auto"],
    )
    hardening: HardeningHandling = Field(
        HardeningHandling.AUTO,
        description="Beam hardening and scattered radiation that the calibration found. `auto`: they are taken out of "
        "the line integrals before these are reconstructed. `none`: neither is taken out.",
        examples=["auto"],
    )
    alpha: Annotated[Positive | None, OfTikhonov] = Field(
        None,
        description="Of `tikhonov`: regularisation weight, in mm². By default chosen by alpha_rule.",
        examples=[40.0],
    )
    alpha_rule: Annotated[AlphaRule, OfTikhonov] = Field(
        AlphaRule.CROSS_VALIDATION, description="How `tikhonov` chooses alpha.", examples=["cross-validation"]
    )
    sigma: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Of `cauchy_map`: standard deviation of a line integral, in its unit. By default a multiple of "
        "the noise in air, chosen by tuning on a synthetic scan of the same log.",
        examples=[0.02],
    )
    beta: Annotated[Positive | None, OfCauchyMap] = Field(
        None,
        description="Of `cauchy_map`: scale of the differences between neighbouring pixels, in the volume's unit. "
        "By default chosen with sigma, or a usual share of the wood's attenuation where sigma is given.",
        examples=[0.0004],
    )
    preset: Annotated[Literal["paper"] | None, OfCauchyMap] = Field(
        None,
        description="Of `cauchy_map`: the published settings (arXiv 2206.14444), instead of sigma and beta.",
        examples=["paper"],
    )
    weight: Annotated[Positive | None, OfTotalVariation] = Field(
        None,
        description="Of `total_variation`, in 1 / attenuation. By default chosen by cross-validation.",
        examples=[0.5],
    )
    coupling: Annotated[Coupling, OfTotalVariation] = "auto"
    non_negative: Annotated[bool, OfEdgePreserving] = Field(
        default=True, description="Of `cauchy_map` and `total_variation`: no attenuation below zero.", examples=[True]
    )
    uncertainty: Annotated[bool, OutOfUse("0.2.0", "2026-11-22", gone_in="0.3.0", instead="leave it out")] = Field(
        default=False,
        description="Ignored, with a remark: each pixel's standard deviation is no longer computed.",
        examples=[False],
    )

    @field_validator(*COMPUTABLE)
    @classmethod
    def _can_be_computed_with(cls, value: float | None, info: ValidationInfo) -> float | None:
        least, largest = COMPUTABLE[str(info.field_name)]
        if value is None or cls.is_stored or least <= value <= largest:
            return value
        msg = f"must be from {least:g} to {largest:g}, not {value:g}"
        raise ValueError(msg)

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

    # Slices were not coupled by an earlier version.
    coupling: Annotated[Coupling, OfTotalVariation] = "none"
    scan_id: Identifier = Field(examples=["example"], description="Id of the scan to reconstruct.")
    calibration_id: Identifier | None = Field(
        None, description="Null: the scanner's active calibration, unless theta is given.", examples=["example"]
    )
    theta: Theta | None = Field(None, description="A geometry of your own, instead of a calibration.")
    rotation: Rotation | None = Field(
        None, description="With theta: which way the angles count.", examples=["as-given"]
    )
    handedness: Handedness | None = Field(
        None, description="With theta: recorded in the result.", examples=["as-drawn"]
    )

    @model_validator(mode="after")
    def _one_geometry(self) -> "ReconstructionAsked":
        if self.theta is not None and self.calibration_id is not None:
            msg = "give calibration_id or theta, not both"
            raise ValueError(msg)
        if self.theta is None and (self.rotation is not None or self.handedness is not None):
            msg = "rotation and handedness come with theta; a calibration carries its own"
            raise ValueError(msg)
        return self


def _state_conditions(schema: Schema, ask: type[ReconstructionOptions]) -> None:
    """What goes with what, as the validators above have it."""
    bounded(schema, COMPUTABLE)
    for name, field in ask.model_fields.items():
        mark = OptionOf.on(field)
        if mark is not None:
            as_left_out = one_of(name, [field.default, EARLIER_DEFAULTS.get(name, field.default)])
            require(schema, name, as_left_out, one_of("method", mark.methods, default=ReconstructionMethod.FBP))
    rules = one_of(
        "alpha_rule", [AlphaRule.CROSS_VALIDATION, AlphaRule.DISCREPANCY], default=AlphaRule.CROSS_VALIDATION
    )
    require(schema, "alpha", without("alpha"), rules)
    require(schema, "preset", without("preset"), without("sigma", "beta"))
    require(schema, "theta", without("theta"), without("calibration_id"))
    for name in ("rotation", "handedness"):
        require(schema, name, without(name), {"properties": {"theta": {"type": "object"}}, "required": ["theta"]})


class ReconstructionAsk(ReconstructionAsked, Given):
    """Ask for a reconstruction with a calibration (the scanner's active one unless named) or with a theta."""

    model_config = ConfigDict(json_schema_extra=_state_conditions)

    is_stored: ClassVar[bool] = False

    views: ChosenViews | None = Field(
        None, description=ReconstructionOptions.model_fields["views"].description, examples=[180]
    )
    coupling: Annotated[Coupling, OfTotalVariation] = "auto"
    theta: GivenTheta | None = Field(None, description="A geometry of your own, instead of a calibration.")


class MetalReport(Contract):
    """Metal that was found in a log, and what was done about it."""

    slices: int = Field(description="Number of slices that show metal.", examples=[3])
    samples: int = Field(
        description="Number of line integrals of these slices whose rays cross metal or pass beside it.",
        examples=[1200],
    )
    share_of_samples: float = Field(
        description="Their share of all line integrals of these slices, no unit.", examples=[0.002]
    )
    treatment: MetalTreatment = Field(description="What was done about these rays.", examples=["interpolated"])
    source: str = Field(
        description="The name of the method that deals with them, and where it was published.",
        examples=["linear interpolation (Kalender 1987)"],
    )


class MethodReport(Contract):
    """The method's parameters, and how well its slices explain the data. Of several slices, the median."""

    name: ReconstructionMethod = Field(
        description="The method used; never `auto`, but the one that it chose.", examples=["fbp"]
    )
    reason: str | None = Field(
        None,
        description="Why `auto` chose it. Null: `auto` was not asked for.",
        examples=["360 views all round suffice for fbp"],
    )
    expected_error: float | None = Field(
        None,
        description="With `auto`: the relative error, no unit, of simulated logs from as many views, with as much "
        "noise. Null where the views do not go all round.",
        examples=[0.08],
    )
    view_step: int = Field(1, description="With `auto`: every view_step-th of the views was used.", examples=[1])
    noise: float = Field(description="Standard deviation of a line integral, in its unit.", examples=[0.01])
    data_misfit: float | None = Field(
        description="RMS of the residual (A x - y), relative to the noise, no unit: near 1 for an iterative method "
        "with the "
        "right geometry, far above where the geometry is wrong. `fbp` does not fit the data: with the right geometry "
        "anything from 1 to 80, and a remark where it shows a wrong one; null where the field does not hold all of "
        "the log. Of a region of interest: of the rays through it.",
        examples=[1.04],
    )
    worst_data_misfit: float | None = Field(
        description="The largest `data_misfit` of all slices, no unit; for `fbp`, of five. Null with it.",
        examples=[1.2],
    )
    alpha: float | None = Field(None, description="Used by `tikhonov`, in mm². Null: another method.", examples=[40.0])
    sigma: float | None = Field(
        None, description="Used by `cauchy_map`, in the unit of a line integral. Null: another method.", examples=[0.02]
    )
    beta: float | None = Field(
        None, description="Used by `cauchy_map`, in the volume's unit. Null: another method.", examples=[0.0004]
    )
    weight: float | None = Field(
        None, description="Used by `total_variation`, in 1 / attenuation. Null: another method.", examples=[0.5]
    )
    coupling: float | None = Field(
        None,
        description="Used by `total_variation`: the weight of a difference along the axis relative to one in the "
        "plane, no unit. 0: each slice by itself. Null: another method.",
        examples=[0.5],
    )
    metal: MetalReport | None = Field(None, description="Null: none was found, or it was not looked for.")
    unconverged_slices: int = Field(
        0, description="Number of slices that had not converged when the iterations ran out.", examples=[0]
    )
    remarks: list[str] = Field(
        [], description="What to know of the data and the fit.", examples=[["the log leaves the field in 3 slices"]]
    )


class ReconstructionResult(Contract):
    """The result beside the volume."""

    shape: tuple[int, int, int] = Field(description="Number of values along (slice, x, y).", examples=[[16, 256, 256]])
    pixel_mm: float = Field(description="Side of a pixel, mm.", examples=[1.5625])
    unit: str = Field(description="Unit of the volume's values.", examples=["1/mm"])
    value_range: tuple[float, float] = Field(
        description="0.1 and 99.9 percentile over the volume, in its unit.", examples=[[0.0, 0.031]]
    )
    theta: Theta = Field(description="The geometry that it was made with.")
    rotation: Rotation = Field(description="Which way the view angles count.", examples=["as-given"])
    handedness: Handedness = Field(
        description="From which end the phantom was seen; recorded with the geometry.", examples=["as-drawn"]
    )
    views: int = Field(description="Number of views of the scan.", examples=[360])
    fewest_views: int | None = Field(
        None,
        description="Number of views of the slice that fewest views show, where views lost rows. Null: none did.",
        examples=[350],
    )
    rows: tuple[int, int] = Field(
        description="Detector rows that were reconstructed: the first one and the one after the last.",
        examples=[[0, 16]],
    )
    row_step: int = Field(1, description="Every row_step-th of the rows is a slice.", examples=[1])
    time_s: float = Field(description="Seconds that the computation took.", examples=[5.3])
    software_version: str = Field(description="Version of the software that computed it.", examples=["0.15.0"])
    input_sha256: str = Field(
        description="SHA-256 of the scan's file, in hexadecimal digits.",
        examples=["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"],
    )
    preparation: list[str] = Field(
        [], description="The steps that prepared the scan's data.", examples=[["flat and dark fields were applied"]]
    )
    method: MethodReport | None = Field(
        None, description="Null for a result of an earlier version, whose method was fbp."
    )
    has_deviation: bool = Field(
        default=False,
        description="Of an earlier version's result: each pixel's standard deviation is in the volume.",
        examples=[False],
    )


class ReconstructionLinks(Contract):
    """Links to its files."""

    self: str = Field(description="Its own path.", examples=["/v1/reconstructions/example"])
    job: str = Field(description="Path of its job.", examples=["/v1/jobs/example"])
    volume: str = Field(description="Path of the volume as HDF5.", examples=["/v1/reconstructions/example/volume.h5"])
    first_slice: str = Field(
        description="Path of the picture of the first slice.", examples=["/v1/reconstructions/example/slices/0.png"]
    )
    first_slice_array: str = Field(
        description="Path of the first slice as an array.", examples=["/v1/reconstructions/example/slices/0.npy"]
    )
    mosaic: str = Field(
        description="Path of the picture of slices along the log.", examples=["/v1/reconstructions/example/mosaic.png"]
    )
    side: str = Field(
        description="Path of the picture of the log from the side.", examples=["/v1/reconstructions/example/side.png"]
    )
    side_array: str = Field(
        description="Path of the side view as an array.", examples=["/v1/reconstructions/example/side.npy"]
    )
    thumbnail: str = Field(
        description="Path of the small picture.", examples=["/v1/reconstructions/example/thumbnail.png"]
    )


class Reconstruction(Stamped):
    """A reconstruction and its state."""

    state: JobState = Field(description="State of its job.", examples=["succeeded"])
    scanner_id: Identifier = Field(description="Id of the scanner.", examples=["example"])
    scan_id: Identifier = Field(description="Id of the scan that is reconstructed.", examples=["example"])
    calibration_id: Identifier | None = Field(
        description="Id of the calibration that it is made with. Null: a theta was given.", examples=["example"]
    )
    job_id: Identifier = Field(description="Id of the job that computes it.", examples=["example"])
    options: ReconstructionAsked = Field(description="What was asked.")
    result: ReconstructionResult | None = Field(None, description="The answer. Null: there is none yet.")
    failure: Failure | None = Field(None, description="Why it failed. Null: it has not.")
    links: ReconstructionLinks | None = Field(None, description="Where it and its files are.")


DECLARATION = AskedKind(
    kind=job_kinds.RECONSTRUCT,
    noun="reconstruction",
    label=N_("Reconstruction of a log"),
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
    result_file="volume.h5",
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
