"""Phantoms: polygons and discs in mm, or a picture and its width."""

import math
from dataclasses import replace
from datetime import date
from enum import StrEnum
from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator

from sawmill_worker.contracts.base import Contract, Identifier, Name, PositiveMm, Stamped
from sawmill_worker.contracts.given import Given
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.kinds import UploadedKind
from sawmill_worker.vocabulary import STANDARD_SIZE_TOLERANCE, Disc, Shape, TrueAxis, fault_of_outline

# The smallest body that can be drawn, and the least and the largest density against wood's: the science squares them.
SMALLEST_RADIUS_MM, SMALLEST_AREA_MM2 = 0.1, 0.01
SMALLEST_DENSITY, LARGEST_DENSITY = 1e-6, 1000.0
# The least sum of density times area, against the largest single shape's, that is more than rounding.
ROUNDING = 1e-9


# What a drawing holds: its `kind` tells which.
DrawnShape = Annotated[Shape, Field(discriminator="kind")]


LARGEST_SIZE_TOLERANCE = 0.1
SizeTolerance = Annotated[float, Field(ge=0, lt=LARGEST_SIZE_TOLERANCE)]
SizeTolerancePercent = Annotated[float, Field(ge=0, lt=100 * LARGEST_SIZE_TOLERANCE)]


class SizeMeasurement(Contract):
    """A length of a phantom, as it was measured."""

    what: Name = Field(
        description="x or y: the drawing's extent along that axis. Any other words: another length.", examples=["x"]
    )
    measured_mm: PositiveMm
    standard_uncertainty_mm: PositiveMm = Field(description="Of the measured length.")
    nominal_mm: PositiveMm | None = Field(None, description="What it was meant to be.")
    measured_on: date | None = None
    instrument: Name | None = Field(None, examples=["caliper 12"])
    moisture_percent: Annotated[float, Field(ge=0, le=200)] | None = Field(
        None, description="Of the wood when it was measured, against its dry weight."
    )
    expires_on: date | None = Field(None, description="After this day an answer asks for a new measurement.")

    @property
    def relative_uncertainty(self) -> float:
        """Standard uncertainty as a share of the length."""
        return self.standard_uncertainty_mm / self.measured_mm

    @model_validator(mode="after")
    def _is_precise_enough(self) -> Self:
        if self.relative_uncertainty >= LARGEST_SIZE_TOLERANCE:
            msg = (
                f"standard_uncertainty_mm {self.standard_uncertainty_mm:g} of measured_mm {self.measured_mm:g} must be "
                f"less than {LARGEST_SIZE_TOLERANCE:.0%} of it"
            )
            raise ValueError(msg)
        return self


def _measured_tolerance(known: dict[str, Any]) -> float:
    """What the measurements of a drawing say of its size, where it states no tolerance: RMS of their uncertainties."""
    measured: list[SizeMeasurement] = known.get("measurements", [])
    if not measured:
        return STANDARD_SIZE_TOLERANCE
    return math.hypot(*(each.relative_uncertainty for each in measured)) / math.sqrt(len(measured))


class PhantomDrawing(Contract):
    """A phantom by its drawing, the rotation centre at the origin."""

    name: Name = Field(examples=["our cross"])
    shapes: list[DrawnShape] = Field(min_length=1, max_length=200)
    measurements: list[SizeMeasurement] = Field(
        [], max_length=100, description="Where its size comes from; the shapes are drawn as measured."
    )
    size_tolerance: SizeTolerance = Field(
        default_factory=_measured_tolerance,
        description="Relative standard uncertainty of the stated size; the scanner's scale inherits it. By default the "
        f"RMS of the measurements' relative uncertainties, {STANDARD_SIZE_TOLERANCE:g} without any.",
    )
    true_axis: TrueAxis | None = Field(
        None, description="Axis along which the size is right, where the phantom may differ along the other."
    )


class PhantomAsk(PhantomDrawing, Given):
    """A phantom as somebody draws it, every shape with an inside. Also the JSON file of `--phantom FILE.json`."""

    @field_validator("shapes")
    @classmethod
    def _are_a_body(cls, shapes: list[DrawnShape]) -> list[DrawnShape]:
        shapes = [_unclosed(shape) for shape in shapes]
        for number, shape in enumerate(shapes):
            if (fault := _fault(shape)) is not None:
                msg = f"shape {number}, counted from 0, {fault}"
                raise ValueError(msg)
        if (outside := _hole_outside(shapes)) is not None:
            raise ValueError(outside)
        masses = [shape.density * shape.area_mm2 for shape in shapes]
        if sum(masses) <= ROUNDING * max(masses):
            msg = f"the shapes' densities times their areas add up to {sum(masses):.4g} mm²: wood must outweigh holes"
            raise ValueError(msg)
        return shapes


def _unclosed(shape: Shape) -> Shape:
    """A polygon without a last corner that repeats the first, as other programs close theirs; others as they are."""
    if isinstance(shape, Disc) or len(shape.vertices_mm) == 3 or shape.vertices_mm[0] != shape.vertices_mm[-1]:
        return shape
    return replace(shape, vertices_mm=shape.vertices_mm[:-1])


def _fault(shape: Shape) -> str | None:
    """Why a shape cannot be drawn, and what would be right."""
    if abs(shape.density) > LARGEST_DENSITY:
        return f"has density {shape.density:.4g}: give one within ±{LARGEST_DENSITY:g}, wood being 1"
    if 0.0 < abs(shape.density) < SMALLEST_DENSITY:
        return f"has density {shape.density:.4g}: give 0 or one of at least {SMALLEST_DENSITY:g}, wood being 1"
    if isinstance(shape, Disc):
        small = shape.radius_mm < SMALLEST_RADIUS_MM
        return (
            f"is a disc of radius {shape.radius_mm:.4g} mm: give at least {SMALLEST_RADIUS_MM:g} mm" if small else None
        )
    if shape.area_mm2 < SMALLEST_AREA_MM2:
        return (
            f"is a polygon that encloses {shape.area_mm2:.4g} mm²: give corners that enclose at least "
            f"{SMALLEST_AREA_MM2:g} mm², not all on one line"
        )
    fault = fault_of_outline(shape.vertices_mm)
    return None if fault is None else f"is a polygon that {fault}"


def _hole_outside(shapes: list[DrawnShape]) -> str | None:
    """A sentence on a shape that takes wood away beyond the extent of all that give it."""
    wood = [shape.extent_mm for shape in shapes if shape.density > 0.0]
    for number, shape in enumerate(shapes):
        if shape.density >= 0.0 or not wood:
            continue
        for axis, name in enumerate("xy"):
            low, high = min(each[axis] for each in wood), max(each[axis + 2] for each in wood)
            first, last = shape.extent_mm[axis], shape.extent_mm[axis + 2]
            if first < low - SMALLEST_RADIUS_MM or last > high + SMALLEST_RADIUS_MM:
                return (
                    f"shape {number}, counted from 0, is a hole from {name} = {first:g} to {last:g} mm: the wood is "
                    f"from {low:g} to {high:g} mm, and nothing can be taken away beside it"
                )
    return None


class PhantomPicture(Contract):
    """What a phantom's PNG does not show, beside it; a job traces it."""

    name: Name = Field(examples=["our cross"])
    width_mm: PositiveMm = Field(description="Of the whole picture, mm.", examples=[400.0])
    size_tolerance: SizeTolerance = Field(
        STANDARD_SIZE_TOLERANCE, description="Relative standard uncertainty of the stated size."
    )


class PhantomState(StrEnum):
    """A picture is traced by a job; everything else is ready at once."""

    TRACING = "tracing"
    READY = "ready"
    REFUSED = "refused"


class StoredPhantom(Stamped):
    """A phantom that scans can be calibrated against."""

    name: Name
    built_in: bool
    state: PhantomState
    reason: str | None = Field(None, description="Why a picture was refused, in one sentence.")
    drawing: PhantomDrawing | None = Field(description="Null until a picture has been traced.")
    job_id: Identifier | None = None


DECLARATION = UploadedKind(
    kind=JobKind.TRACE_PHANTOM,
    noun="phantom",
    result=PhantomDrawing,
    upload="picture",
    lighter="give a picture of fewer pixels",
)
