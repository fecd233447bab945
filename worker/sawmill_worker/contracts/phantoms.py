"""Phantoms: polygons and discs in mm, or a picture and its width."""

import math
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from sawmill_worker.contracts.base import Contract, CoordinateMm, Identifier, Name, PositiveMm, Stamped
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.kinds import UploadedKind

Point = tuple[CoordinateMm, CoordinateMm]
# The least that is a body, and the most that any attenuates against wood.
SMALLEST_RADIUS_MM, SMALLEST_AREA_MM2, LARGEST_DENSITY = 0.1, 0.01, 1000.0
# What shapes add up to, against the largest of them, below which rounding is all there is.
ROUNDING = 1e-9


class PolygonShape(Contract):
    """A closed polygon; its vertices may run either way round."""

    kind: Literal["polygon"] = "polygon"
    vertices_mm: list[Point] = Field(min_length=3, max_length=2000, description="(x, y) of each corner.")
    density: float = Field(1.0, description="Adds to what lies beneath: 1 is wood, -1 cuts a hole into wood.")

    @property
    def area_mm2(self) -> float:
        """Enclosed; 0 where the corners lie on one line."""
        x0, y0 = self.vertices_mm[0]
        corners = [(x - x0, y - y0) for x, y in self.vertices_mm]
        return 0.5 * abs(sum(xa * yb - xb * ya for (xa, ya), (xb, yb) in pairwise([*corners, corners[0]])))


class DiscShape(Contract):
    """A disc."""

    kind: Literal["disc"] = "disc"
    center_mm: Point
    radius_mm: PositiveMm
    density: float = Field(1.0, description="Adds to what lies beneath: 1 is wood, -1 cuts a hole into wood.")

    @property
    def area_mm2(self) -> float:
        """Enclosed."""
        return math.pi * self.radius_mm**2


Shape = Annotated[PolygonShape | DiscShape, Field(discriminator="kind")]


class PhantomDrawing(Contract):
    """A phantom as its drawing says, the rotation centre at the origin."""

    name: Name = Field(examples=["our cross"])
    shapes: list[Shape] = Field(min_length=1, max_length=200)
    size_tolerance: float = Field(
        0.001,
        ge=0,
        lt=0.1,
        description="Relative standard uncertainty of the stated size; the scanner's scale inherits it.",
    )


class PhantomAsk(PhantomDrawing):
    """A phantom as somebody draws it, every shape with an inside. Also the JSON file of `--phantom FILE.json`."""

    @field_validator("shapes")
    @classmethod
    def _are_a_body(cls, shapes: list[Shape]) -> list[Shape]:
        for number, shape in enumerate(shapes):
            if (fault := _fault(shape)) is not None:
                msg = f"shape {number}, counted from 0, {fault}"
                raise ValueError(msg)
        masses = [shape.density * shape.area_mm2 for shape in shapes]
        if sum(masses) <= ROUNDING * max(masses):
            msg = f"the shapes' densities times their areas add up to {sum(masses):.4g} mm²: wood must outweigh holes"
            raise ValueError(msg)
        return shapes


def _fault(shape: Shape) -> str | None:
    """Why a shape is none, and what would be right."""
    if abs(shape.density) > LARGEST_DENSITY:
        return f"has density {shape.density:.4g}: give one within ±{LARGEST_DENSITY:g}, wood being 1"
    if isinstance(shape, DiscShape):
        if shape.radius_mm < SMALLEST_RADIUS_MM:
            return f"is a disc of radius {shape.radius_mm:.4g} mm: give at least {SMALLEST_RADIUS_MM:g} mm"
    elif shape.area_mm2 < SMALLEST_AREA_MM2:
        return (
            f"is a polygon that encloses {shape.area_mm2:.4g} mm²: give corners that enclose at least "
            f"{SMALLEST_AREA_MM2:g} mm², not all on one line"
        )
    return None


class PhantomPicture(Contract):
    """What has to be said of a phantom's PNG, which a job traces."""

    name: Name = Field(examples=["our cross"])
    width_mm: PositiveMm = Field(description="Of the whole picture.", examples=[400.0])
    size_tolerance: float = Field(0.001, ge=0, lt=0.1, description="Relative standard uncertainty of the stated size.")


class PhantomState(StrEnum):
    """A picture is traced by a job; everything else is ready at once."""

    TRACING = "tracing"
    READY = "ready"
    REFUSED = "refused"


class Phantom(Stamped):
    """A phantom that scans can be calibrated against."""

    name: Name
    built_in: bool
    state: PhantomState
    reason: str | None = Field(None, description="Why a picture was refused, in one sentence.")
    drawing: PhantomDrawing | None = Field(description="Null until a picture has been traced.")
    job_id: Identifier | None = None


DECLARATION = UploadedKind(kind=JobKind.TRACE_PHANTOM, noun="phantom", result=PhantomDrawing, upload="picture")
