"""The flags that several commands share, and what is wrong use of them: found before any file is read."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from sawmill_worker.contracts.base import Rows
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.geometry import GivenTheta, Theta
from sawmill_worker.contracts.preparing import PrepareOptions
from sawmill_worker.files.errors import UnreadableScan
from sawmill_worker.readers.angles import AnglesGiven, parse_angles, read_angles_file
from sawmill_worker.vocabulary import AirCorrection, DataKind, FaultyCells, RingRemoval, Rotation, RowAlignment

LARGEST_MM = 1e5
CALIBRATION_HELP = "What calibrate --json printed, or a calibration's result.h5 from the service."
THETA_HELP = "alpha0 (rad), r_D, h_S, h_D (mm), alpha_D, separated by commas."
THETA_FORM = "a,r,h,h,t"
# What pydantic calls a number beyond its bounds.
OUT_OF_BOUNDS = frozenset({"greater_than", "greater_than_equal", "less_than", "less_than_equal"})


def length(value: float | None) -> float | None:
    """Refuse what is no length (a callback of Typer's)."""
    if value is not None and not 0.0 < value <= LARGEST_MM:
        raise typer.BadParameter(f"{value} is not a length in mm above 0 and up to {LARGEST_MM:g}.")
    return value


def whole_number(text: str) -> int:
    """Read a number of pixels (a parser of Typer's)."""
    return int(_square(text, int))


def number(text: str) -> float:
    """Read a side of a square (a parser of Typer's)."""
    return _square(text, float)


def _square(text: str, kind: type[int] | type[float]) -> float:
    try:
        return kind(text)
    except ValueError as error:
        msg = f"{text!r} is not one number: pixels are square, and one number says both sides."
        raise typer.BadParameter(msg) from error


def writable(path: Path | None) -> Path | None:
    """Refuse a file in a folder that does not exist, before long work is done for it (a callback of Typer's)."""
    if path is not None and not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"there is no folder {str(path.parent)!r} to write {path.name!r} into.")
    return path


ScanFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCAN",
        exists=True,
        dir_okay=False,
        help="The scan: HDF5 (NXtomo, Data Exchange), TIFF, ZIP of TIFFs, NPY, NPZ or MAT.",
    ),
]
Data = Annotated[DataKind, typer.Option("--data", help="What the numbers are; never guessed.")]
Dataset = Annotated[
    str | None, typer.Option(help="The projections' path or variable, where the file holds several arrays.")
]
AnglesDeg = Annotated[
    str | None, typer.Option(metavar="START:STEP", help="View angles in degrees, where the file carries none.")
]
AnglesFile = Annotated[
    Path | None, typer.Option(exists=True, dir_okay=False, help="Text file, one view's angle in degrees a line.")
]
Views = Annotated[int | None, typer.Option(min=3, help="Use every (total / VIEWS)-th view, each with its own angle.")]
RowsText = Annotated[
    str | None, typer.Option("--rows", metavar="A:B", help="Detector rows, the first included, the last not.")
]
SteppedRowsText = Annotated[
    str | None,
    typer.Option(
        "--rows", metavar="A:B[:STEP]", help="Detector rows, the first included, the last not, or every STEP-th."
    ),
]
SourceToCor = Annotated[
    float, typer.Option("--source-to-cor-mm", callback=length, help="r_S, source to centre of rotation.")
]
DetectorPitch = Annotated[
    float | None,
    typer.Option(
        "--detector-pitch-mm",
        callback=length,
        help="Distance between detector cells; needed where the file does not carry it.",
    ),
]
RowPitch = Annotated[
    float | None, typer.Option("--row-pitch-mm", callback=length, help="Distance between detector rows.")
]
AirFlag = Annotated[
    AirCorrection,
    typer.Option("--air", help="Level of the air at the detector's ends, taken out; auto: of counts, where it drifts."),
]
FaultyCellsFlag = Annotated[
    FaultyCells, typer.Option("--faulty-cells", help="Dead and hot cells; auto: bridged in counts.")
]
RingsFlag = Annotated[RingRemoval, typer.Option("--rings", help="Remove rings that unequal cells leave.")]
AlignRows = Annotated[
    RowAlignment, typer.Option("--align-rows", help="Lay views that lost rows (NaN, or zero counts) over one another.")
]
PhantomText = Annotated[
    str,
    typer.Option(
        "--phantom",
        metavar="NAME|FILE",
        help=f"{', '.join(BUILT_IN_PHANTOMS)}, a drawing FILE.json, or a picture FILE.png, bright where wood is.",
    ),
]
PhantomWidth = Annotated[
    float | None, typer.Option(callback=length, help="Width of a phantom's PNG, the whole picture.")
]
ImageSize = Annotated[
    int, typer.Option("--size", parser=whole_number, metavar="INTEGER", help="Pixels along each side, 16 to 4096.")
]
FieldSide = Annotated[
    float,
    typer.Option("--field-mm", parser=number, metavar="FLOAT", callback=length, help="Side of the square field."),
]
FieldCentre = Annotated[
    str,
    typer.Option(
        "--field-centre-mm",
        metavar="X,Y",
        help="Middle of the field from the centre of rotation: a region of interest.",
    ),
]
Result = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="OUT", dir_okay=False, callback=writable, help="The file that is written."),
]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]


class ExportTarget(StrEnum):
    """Toolkits that a geometry can be written for."""

    ASTRA = "astra"
    ODL = "odl"
    CIL = "cil"
    RTK = "rtk"


@dataclass(frozen=True)
class ScanSaid:
    """What is said of a scan's file, and which of its views and rows are to be used."""

    path: Path
    data: DataKind
    dataset: str | None
    angles: AnglesGiven | None
    views: int | None
    rows: Rows | None
    detector_pitch_mm: float | None
    row_pitch_mm: float | None
    prepare: PrepareOptions = field(default_factory=PrepareOptions)


@dataclass(frozen=True)
class PicturesSaid:
    """Which pictures of a volume are to be written, and where: its middle slice, slices along it, its side, alpha."""

    middle: Path | None
    mosaic: Path | None
    side: Path | None
    alpha_curve: Path | None


@dataclass(frozen=True)
class PhantomSaid:
    """Which phantom is meant: a built-in one's name, or a file, and the width of a picture."""

    text: str
    width_mm: float | None

    def __post_init__(self) -> None:
        """Refuse what is neither, and a width that is missing or belongs to nothing."""
        if self.text not in BUILT_IN_PHANTOMS:
            self._check_file()
        elif self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a built-in phantom has its size.")

    def _check_file(self) -> None:
        if not self.path.is_file():
            raise typer.BadParameter(
                f"--phantom must be {', '.join(BUILT_IN_PHANTOMS)} or an existing file, not {self.text!r}."
            )
        if self.is_drawing and self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a drawing is in mm already.")
        if not self.is_drawing and self.width_mm is None:
            raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm.")

    @property
    def path(self) -> Path:
        """Of the file."""
        return Path(self.text)

    @property
    def is_drawing(self) -> bool:
        """Whether the file is JSON."""
        return self.path.suffix.lower() == ".json"


@dataclass(frozen=True)
class ThetaSaid:
    """A geometry by its numbers."""

    theta: Theta
    rotation: Rotation
    source_to_cor_mm: float


@dataclass(frozen=True)
class CalibrationSaid:
    """A geometry by the file of a calibration; a constant given beside it must agree."""

    path: Path
    source_to_cor_mm: float | None


@contextmanager
def wrong_use_told() -> Iterator[None]:
    """Turn a value that a contract refuses into wrong use of the flag that carries it."""
    try:
        yield
    except ValidationError as error:
        first = error.errors()[0]
        flag = "-".join(str(part) for part in first["loc"]).replace("_", "-")
        # What a contract says of several values together names them itself.
        raise typer.BadParameter(f"--{flag}: {complaint(error)}" if flag else complaint(error)) from error


def complaint(error: ValidationError) -> str:
    """What a contract says first."""
    return error.errors()[0]["msg"].removeprefix("Value error, ")


def given_angles(angles_deg: str | None, angles_file: Path | None) -> AnglesGiven | None:
    """The angles of the flags; giving both is wrong use."""
    if angles_deg is not None and angles_file is not None:
        raise typer.BadParameter("give --angles-deg or --angles-file, not both.")
    try:
        if angles_file is not None:
            return read_angles_file(angles_file)
        return None if angles_deg is None else parse_angles(angles_deg)
    except UnreadableScan as error:
        raise typer.BadParameter(str(error)) from error


def parse_theta(text: str) -> Theta:
    """Theta from five numbers separated by commas, each within what a scanner can be."""
    try:
        return GivenTheta.model_validate(dict(zip(GivenTheta.model_fields, text.split(","), strict=True)))
    except ValueError as error:
        told = _out_of_bounds(error) if isinstance(error, ValidationError) else None
        told = told or f"--theta needs five numbers {THETA_FORM}, not {text!r}."
        raise typer.BadParameter(told) from error


def _out_of_bounds(error: ValidationError) -> str | None:
    """Which of theta's numbers is out of its range; None where something else is wrong with it."""
    first = error.errors()[0]
    if first["type"] not in OUT_OF_BOUNDS:
        return None
    name = first["loc"][0]
    allowed = GivenTheta.model_json_schema()["properties"][name]
    low = allowed.get("minimum", allowed.get("exclusiveMinimum"))
    return f"--theta: {name} must lie between {low:g} and {allowed['maximum']:g}, not {first['input']}."


def parse_position(text: str, flag: str = "--position-mm") -> tuple[float, float]:
    """X and Y in mm, each within what a scanner measures."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{flag} needs X,Y, not {text!r}.") from error
    if not (abs(x) <= LARGEST_MM and abs(y) <= LARGEST_MM):
        raise typer.BadParameter(
            f"{flag}: X and Y must lie between {-LARGEST_MM:g} and {LARGEST_MM:g} mm, not {text!r}."
        )
    return x, y
