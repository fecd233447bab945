"""Flags of a geometry, as numbers or as a calibration, and checks of their use."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeVar

import typer
from pydantic import TypeAdapter, ValidationError

from sawmill_contracts.geometry import GivenTheta, ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import CoordinateMm, Rotation, Theta
from sawmill_worker.commands.from_contract import OUT_OF_BOUNDS, field_names, option, sentence
from sawmill_worker.commands.terminal import Command, OneOf

CALIBRATION_HELP = "What calibrate --json printed, or a calibration's result.h5 from the service."


class Position(Contract):
    """A point in the scanned plane, in mm."""

    x: CoordinateMm = 0.0
    y: CoordinateMm = 0.0


Numbers = TypeVar("Numbers", GivenTheta, Position)


class WithGeometry(Command):
    """A command that needs a geometry, as five numbers, as a calibration or as vectors."""

    one_of = OneOf(("theta", "calibration", "geometry"), "the geometry")
    needs: ClassVar = {"theta": "source_to_cor_mm"}


@dataclass(frozen=True)
class GeometryFlags:
    """The geometry of the flags: five numbers with r_S, a calibration whose constants must agree, or vectors."""

    theta: Theta | None
    rotation: Rotation | None
    calibration: Path | None
    source_to_cor_mm: float | None
    vectors: Path | None

    def __post_init__(self) -> None:
        """Refuse a rotation that comes with a calibration or vectors."""
        if self.rotation is not None and self.theta is None:
            raise typer.BadParameter("--rotation comes with --theta; a calibration carries its own.")


def theta_of(text: str) -> Theta:
    """Parse theta from five numbers separated by commas; angles may be in degrees as 146.1deg (a Typer parser)."""
    return _numbers(text, GivenTheta, "five numbers a,r,h,h,t", GivenTheta.numbers)


def position_of(text: str) -> Position:
    """Parse a position from X,Y (a Typer parser)."""
    return _numbers(
        text, Position, "X,Y", lambda pair: dict(zip(Position.model_fields, map(float, pair.split(",")), strict=True))
    )


def _numbers(text: str, contract: type[Numbers], form: str, read: Callable[[str], dict[str, float]]) -> Numbers:
    try:
        return TypeAdapter(contract).validate_python(read(text))
    except ValueError as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        if first is not None and first["type"] in OUT_OF_BOUNDS:
            name = str(first["loc"][0])
            first["input"] = text.split(",")[[*field_names(contract)].index(name)]
            raise typer.BadParameter(f"{name} {sentence(first, contract)}.") from error
        raise typer.BadParameter(f"must be {form}, not {text!r}.") from error


ThetaFlag = typer.Option(
    parser=theta_of,
    metavar="a,r,h,h,t",
    help="alpha0 (as 146.1deg, or rad), r_D, h_S, h_D (mm), alpha_D (as 15.7deg, or a slope), separated by commas.",
)
SourceToCorOfTheta = Annotated[
    float | None, option(ScannerConstants, "source_to_cor_mm", help="r_S, with --theta; a calibration carries it.")
]
RotationOfTheta = Annotated[Rotation | None, option(ReconstructionRequest, "rotation")]
CalibrationFlag = typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help=CALIBRATION_HELP)
GeometryFlag = typer.Option(
    metavar="VECTORS",
    exists=True,
    dir_okay=False,
    help="A file of vectors for each view of the scan, which replace its angles: JSON of export --to vectors, or rows "
    "of ASTRA's fanflat_vec, mm (.npy).",
)
