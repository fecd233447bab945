"""Phantoms: polygons and discs in mm, or a picture and its width; the drawings of the two published phantoms."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Any, Self

from pydantic import ConfigDict, Field, field_validator, model_validator

from sawmill_contracts import kinds
from sawmill_contracts.choices import Axis
from sawmill_contracts.geometry import PositiveMm
from sawmill_platform.contracts.base import Contract, Identifier, Name, Stamped
from sawmill_platform.contracts.given import Given, GivenDay
from sawmill_platform.contracts.kind_declarations import UploadedKind
from sawmill_vocabulary import (
    BUILT_IN_OUTLINES,
    PUBLISHED_PRECISION_MM,
    STANDARD_SIZE_TOLERANCE,
    Disc,
    Point,
    Shape,
    TrueAxis,
    fault_of_outline,
)
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.phantoms import LARGEST_DENSITY, SMALLEST_DENSITY, SMALLEST_RADIUS_MM

# The smallest polygon that can be drawn; the science squares this area.
SMALLEST_AREA_MM2 = 0.01
# The least sum of density times area, against the largest single shape's, that is more than rounding.
ROUNDING = 1e-9


# A shape of a drawing; its `kind` gives the type.
DrawnShape = Annotated[Shape, Field(discriminator="kind")]


LARGEST_SIZE_TOLERANCE = 0.1
SizeTolerance = Annotated[float, Field(ge=0, lt=LARGEST_SIZE_TOLERANCE)]
SizeTolerancePercent = Annotated[float, Field(ge=0, lt=100 * LARGEST_SIZE_TOLERANCE)]


class SizeMeasurement(Contract):
    """A measured length of a phantom."""

    dimension: Name = Field(
        description="x or y: the drawing's extent along that axis. Any other words: another length.", examples=["x"]
    )
    measured_mm: PositiveMm = Field(description="Measured length, mm.", examples=[200.1])
    standard_uncertainty_mm: PositiveMm = Field(
        description="Standard uncertainty of the measured length, mm.", examples=[0.05]
    )
    nominal_mm: PositiveMm | None = Field(None, description="Nominal length, mm. Null: not stated.", examples=[200.0])
    measured_on: GivenDay | None = Field(
        None, description="Day of the measurement. Null: not stated.", examples=["2025-11-02"]
    )
    instrument: Name | None = Field(
        None, examples=["caliper 12"], description="Instrument of the measurement. Null: not stated."
    )
    moisture_percent: Annotated[float, Field(ge=0, le=200)] | None = Field(
        None,
        description="Moisture of the wood at the measurement, against its dry weight, per cent. Null: not stated.",
        examples=[11.0],
    )
    expires_on: GivenDay | None = Field(
        None,
        description="Last day on which the measurement is valid; after it an answer requests a new measurement. "
        "Null: it does not expire.",
        examples=["2027-11-02"],
    )

    def expired(self, today: date) -> bool:
        """Return whether the measurement expired before this day."""
        return self.expires_on is not None and self.expires_on < today

    @property
    def relative_uncertainty(self) -> float:
        """Standard uncertainty as a share of the length."""
        return self.standard_uncertainty_mm / self.measured_mm

    @model_validator(mode="after")
    def _is_precise_enough(self) -> Self:
        if self.relative_uncertainty >= LARGEST_SIZE_TOLERANCE:
            raise ValueError(
                f"standard_uncertainty_mm {self.standard_uncertainty_mm:g} of measured_mm {self.measured_mm:g} must be "
                f"less than {LARGEST_SIZE_TOLERANCE:.0%} of it"
            )
        return self


def _measured_tolerance(values: dict[str, Any]) -> float:
    """Return the size tolerance of a drawing that states none: RMS of the measurements' relative uncertainties."""
    measured: list[SizeMeasurement] = values.get("measurements", [])
    if not measured:
        return STANDARD_SIZE_TOLERANCE
    return math.hypot(*(each.relative_uncertainty for each in measured)) / math.sqrt(len(measured))


def _until_tomorrow(measurements: list[SizeMeasurement]) -> list[SizeMeasurement]:
    """Check that no measurement is of a future day. Tomorrow is accepted: it has started in other time zones."""
    last = datetime.now(UTC).date() + timedelta(days=1)
    for each in measurements:
        if each.measured_on is not None and each.measured_on > last:
            raise ValueError(
                f"measured_on {each.measured_on} of {each.dimension} is still to come: give the day of the measurement"
            )
    return measurements


class PhantomDrawing(Contract):
    """A phantom by its drawing, the rotation centre at the origin."""

    name: Name = Field(examples=["our cross"], description="Name for people.")
    shapes: list[DrawnShape] = Field(
        min_length=1,
        max_length=200,
        description="Polygons and discs, mm; each adds its density to the shapes before it.",
    )
    measurements: list[SizeMeasurement] = Field(
        [], max_length=100, description="Measurements of the phantom's size; the shapes are drawn as measured."
    )
    size_tolerance: SizeTolerance = Field(
        default_factory=_measured_tolerance,
        description="Relative standard uncertainty of the stated size, no unit; the scanner's scale inherits it. "
        f"Default: the RMS of the measurements' relative uncertainties, {STANDARD_SIZE_TOLERANCE:g} without any.",
        examples=[0.0015],
    )
    precision_mm: float = Field(
        0.0,
        ge=0.0,
        le=10.0,
        description="How far the drawn outline may be from the phantom's, mm: half the diagonal of a pixel, of a "
        "drawing made of pixels. The phantom's wood is not said to differ from the drawing by less.",
        examples=[0.2],
    )
    true_axis: Axis | None = Field(
        None,
        description="Axis along which the size is right, where the phantom may differ along the other. Null: both.",
        examples=["x"],
    )
    follows: Identifier | None = Field(
        None,
        description="Id of the stored phantom whose new measurement made this one; the earlier phantom stays for "
        "what refers to it. Null: none.",
        examples=["l-shape"],
    )

    @property
    def extent_mm(self) -> tuple[float, float]:
        """Extent of the wood along x and y, mm."""
        low_x, low_y, high_x, high_y = extent_of_wood(self.shapes)
        return high_x - low_x, high_y - low_y

    def measured_anew(self, phantom_id: str, new: list[SizeMeasurement], *, stretched: bool) -> "PhantomDrawing":
        """Return the drawing with new measurements, each in place of an earlier one of the same length.

        Parameters
        ----------
        phantom_id
            Id under which this drawing is stored; the new drawing follows it.
        new
            The new measurements.
        stretched
            Whether the shapes are stretched along x and y, from the rotation centre, to the measured lengths. A disc
            stays one: its radius grows by the geometric mean of both.

        Raises
        ------
        ValueError
            A length along x or y is off by so much that it is another phantom's.
        """
        measured = {each.dimension: each for each in (*self.measurements, *new)}
        factors = [self._factor(axis, measured.get(axis)) for axis in ("x", "y")]
        drawing = PhantomDrawing(
            name=self.name,
            shapes=[_stretched(shape, *factors) for shape in self.shapes] if stretched else self.shapes,
            measurements=list(measured.values()),
            true_axis=self.true_axis,
            follows=phantom_id,
        )
        if drawing.axis_as_drawn is None:
            return drawing
        tolerance = math.hypot(drawing._measured_share(), self._drawn_tolerance()) / math.sqrt(2)
        return drawing.model_copy(update={"size_tolerance": tolerance})

    @property
    def axis_as_drawn(self) -> TrueAxis | None:
        """The one of x and y that was not measured, where the other was and the size depends on both."""
        axes: tuple[TrueAxis, TrueAxis] = ("x", "y")
        measured = {each.dimension for each in self.measurements}
        unmeasured = [axis for axis in axes if axis not in measured]
        return unmeasured[0] if len(unmeasured) == 1 and self.true_axis in {None, unmeasured[0]} else None

    def _measured_share(self) -> float:
        """Return the relative uncertainty along the one axis that was measured."""
        return next(each.relative_uncertainty for each in self.measurements if each.dimension in {"x", "y"})

    def _drawn_tolerance(self) -> float:
        """Return the size tolerance along an axis that was not measured; the standard where the drawing states none.

        A phantom that was measured along one axis holds the RMS of both.
        """
        if self.size_tolerance == _measured_tolerance({"measurements": self.measurements}):
            return STANDARD_SIZE_TOLERANCE
        if self.follows is None or self.axis_as_drawn is None:
            return self.size_tolerance
        return math.sqrt(max(2.0 * self.size_tolerance**2 - self._measured_share() ** 2, 0.0))

    def _factor(self, axis: str, measured: SizeMeasurement | None) -> float:
        """Return the measured extent along an axis over the drawn one; 1 where nothing was measured."""
        if measured is None:
            return 1.0
        drawn_mm = self.extent_mm["xy".index(axis)]
        if abs(measured.measured_mm - drawn_mm) > LARGEST_SIZE_TOLERANCE * drawn_mm:
            raise ValueError(
                f"{axis} was measured as {measured.measured_mm:g} mm and is drawn {drawn_mm:g} mm long: give a length "
                f"within {LARGEST_SIZE_TOLERANCE:.0%} of the drawing, or draw the other phantom"
            )
        return measured.measured_mm / drawn_mm


class MeasurementsRequest(Given):
    """New measurements of a stored phantom's sides."""

    measurements: list[SizeMeasurement] = Field(min_length=1, max_length=100, description="Measured lengths.")
    stretch_drawing: bool = Field(
        default=True, description="Whether the shapes are stretched along x and y to the measured lengths."
    )

    _of_days_that_were = field_validator("measurements")(_until_tomorrow)


def _leave_out_follows(schema: dict[str, Any]) -> None:
    """Leave out the field that the service alone sets, where a stored phantom is measured again."""
    del schema["properties"]["follows"]


class PhantomRequest(PhantomDrawing, Given):
    """A phantom's drawing in a request, every shape with an interior. Also the JSON file of `--phantom FILE.json`."""

    model_config = ConfigDict(json_schema_extra=_leave_out_follows)

    _of_days_that_were = field_validator("measurements")(_until_tomorrow)

    @field_validator("follows")
    @classmethod
    def _are_new(cls, follows: str | None) -> None:
        if follows is not None:
            raise ValueError(
                f"must be left out, not {follows!r}: POST /v1/phantoms/{follows}/measurements measures a phantom anew"
            )

    @field_validator("shapes")
    @classmethod
    def _are_a_body(cls, shapes: list[DrawnShape]) -> list[DrawnShape]:
        shapes = [_unclosed(shape) for shape in shapes]
        for _, sentence in faults_of(dict(enumerate(shapes))):
            raise ValueError(sentence)
        return shapes


def faults_of(shapes: Mapping[int, Shape]) -> Iterator[tuple[int | None, str]]:
    """Find why shapes are no body: the shape's number (None for all of them), and a sentence with what would be right.

    Parameters
    ----------
    shapes
        Shapes by their numbers, counted from 0; sentences count from 1, as people do.
    """
    for number, shape in shapes.items():
        if (fault := _fault(shape)) is not None:
            yield number, f"shape {number + 1} {fault}"
    yield from _holes_outside(shapes)
    masses = [shape.density * shape.area_mm2 for shape in shapes.values()]
    if masses and sum(masses) <= ROUNDING * max(masses):
        yield None, f"the shapes' densities times their areas add up to {sum(masses):.4g} mm²: wood must outweigh holes"


def extent_of_wood(shapes: Iterable[Shape]) -> tuple[float, float, float, float]:
    """Return least x and y, largest x and y of the shapes that give wood, mm; of all shapes where none gives wood."""
    every = list(shapes)
    wood = [shape.extent_mm for shape in every if shape.density > 0.0] or [shape.extent_mm for shape in every]
    low_x, low_y, high_x, high_y = zip(*wood, strict=True)
    return min(low_x), min(low_y), max(high_x), max(high_y)


def _stretched(shape: Shape, along_x: float, along_y: float) -> Shape:
    """Stretch a shape along x and y, to a tenth of a micrometre."""

    def moved(point: Point) -> Point:
        return round(point[0] * along_x, 4), round(point[1] * along_y, 4)

    if isinstance(shape, Disc):
        radius_mm = round(shape.radius_mm * math.sqrt(along_x * along_y), 4)
        return replace(shape, center_mm=moved(shape.center_mm), radius_mm=radius_mm)
    return replace(shape, vertices_mm=tuple(moved(corner) for corner in shape.vertices_mm))


def _unclosed(shape: Shape) -> Shape:
    """Remove a polygon's last corner that repeats the first, as other programs close polygons; keep other shapes."""
    if isinstance(shape, Disc) or len(shape.vertices_mm) == 3 or shape.vertices_mm[0] != shape.vertices_mm[-1]:
        return shape
    return replace(shape, vertices_mm=shape.vertices_mm[:-1])


def _fault(shape: Shape) -> str | None:
    """Return why a shape cannot be drawn, and what would be right."""
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


def _holes_outside(shapes: Mapping[int, Shape]) -> Iterator[tuple[int, str]]:
    """Find each shape that takes wood away beyond the extent of all shapes that give it: its number and a sentence."""
    if not any(shape.density > 0.0 for shape in shapes.values()):
        return
    extent = extent_of_wood(shapes.values())
    for number, shape in shapes.items():
        if shape.density >= 0.0:
            continue
        for axis, name in enumerate("xy"):
            low, high = extent[axis], extent[axis + 2]
            first, last = shape.extent_mm[axis], shape.extent_mm[axis + 2]
            if first < low - SMALLEST_RADIUS_MM or last > high + SMALLEST_RADIUS_MM:
                sentence = (
                    f"shape {number + 1} is a hole from {name} = {first:g} to {last:g} mm: the wood is "
                    f"from {low:g} to {high:g} mm, and nothing can be taken away beside it"
                )
                yield number, sentence
                break


class PhantomPicture(Contract):
    """Properties that a phantom's PNG does not show; a job traces the picture."""

    name: Name = Field(examples=["our cross"], description="Name for people.")
    width_mm: PositiveMm = Field(description="Width of the whole picture, mm.", examples=[400.0])
    size_tolerance: SizeTolerance = Field(
        STANDARD_SIZE_TOLERANCE,
        description="Relative standard uncertainty of the stated size, no unit.",
        examples=[0.0015],
    )


class PhantomState(StrEnum):
    """State of a phantom: a picture is traced by a job first, a drawing is ready at once."""

    TRACING = "tracing"
    READY = "ready"
    REFUSED = "refused"


class StoredPhantom(Stamped):
    """A phantom that scans can be calibrated against."""

    model_config = ConfigDict(title="Phantom")

    name: Name = Field(description="Name for people.", examples=["L-shape"])
    built_in: bool = Field(
        description="Whether the phantom came with the software, and so cannot be deleted.", examples=[True]
    )
    state: PhantomState = Field(description="Whether the phantom can be used.", examples=["ready"])
    reason: str | None = Field(
        None,
        description="Reason why the picture was refused, in one sentence. Null: it was not refused.",
        examples=["the picture shows no wood"],
    )
    drawing: PhantomDrawing | None = Field(
        description="Drawing of the phantom. Null until its picture has been traced."
    )
    job_id: Identifier | None = Field(
        None, description="Id of the job that traces the phantom's picture. Null: the phantom was drawn."
    )


DECLARATION = UploadedKind(
    kind=kinds.TRACE_PHANTOM,
    noun="phantom",
    label=N_("Tracing a phantom's picture"),
    result=PhantomDrawing,
    upload="picture",
    lighter="give a picture of fewer pixels",
)


_NAMES = {"l-shape": "L-shape", "rectangle-with-hole": "Rectangle with hole"}

BUILT_IN_PHANTOMS: Mapping[str, PhantomDrawing] = MappingProxyType(
    {
        phantom_id: PhantomDrawing(name=_NAMES[phantom_id], shapes=list(shapes), precision_mm=PUBLISHED_PRECISION_MM)
        for phantom_id, shapes in BUILT_IN_OUTLINES.items()
    }
)
