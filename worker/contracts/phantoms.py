"""Phantoms: polygons and discs in mm, or a picture and its width."""

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from worker.contracts.base import Contract, Identifier, Name, PositiveMm, Stamped

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Coordinate, Coordinate]


class PolygonShape(Contract):
    """A closed polygon; its vertices may run either way round."""

    kind: Literal["polygon"] = "polygon"
    vertices_mm: list[Point] = Field(min_length=3, max_length=2000, description="(x, y) of each corner.")
    density: float = Field(1.0, description="Adds to what lies beneath: 1 is wood, -1 cuts a hole into wood.")


class DiscShape(Contract):
    """A disc."""

    kind: Literal["disc"] = "disc"
    center_mm: Point
    radius_mm: PositiveMm
    density: float = Field(1.0, description="Adds to what lies beneath: 1 is wood, -1 cuts a hole into wood.")


Shape = Annotated[PolygonShape | DiscShape, Field(discriminator="kind")]


class PhantomDrawing(Contract):
    """A phantom as its drawing says, the rotation centre at the origin. Also the JSON file of `--phantom FILE.json`."""

    name: Name = Field(examples=["our cross"])
    shapes: list[Shape] = Field(min_length=1, max_length=200)
    size_tolerance: float = Field(
        0.001,
        ge=0,
        lt=0.1,
        description="Relative standard uncertainty of the stated size; the scanner's scale inherits it.",
    )


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
