"""The flags that several commands share, and what is wrong use of them: found before any file is read."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, TypeVar

import typer
from pydantic import Field, TypeAdapter, ValidationError
from typer.models import OptionInfo

from sawmill_worker.commands.from_contract import OUT_OF_BOUNDS, Flags, field_names, option, sentence
from sawmill_worker.contracts.base import Contract
from sawmill_worker.contracts.built_in import BUILT_IN_PHANTOMS
from sawmill_worker.contracts.geometry import GivenTheta, ScannerConstants
from sawmill_worker.contracts.jobs import JobKind
from sawmill_worker.contracts.phantoms import PhantomPicture
from sawmill_worker.contracts.reconstructions import ReconstructionAsk
from sawmill_worker.contracts.scans import ScanFileOptions, UnregisteredScanOptions
from sawmill_worker.files.errors import UnreadableScan
from sawmill_worker.readers.angles import AnglesGiven, parse_angles, read_angles_file
from sawmill_worker.use_cases.scan_source import ScanSource
from sawmill_worker.vocabulary import CoordinateMm, Rotation, Theta

CALIBRATION_HELP = "What calibrate --json printed, or a calibration's result.h5 from the service."
# The published scanner (arXiv 2206.14444), as flags of the scanner's constants.
PUBLISHED_SCANNER = {
    "source_to_cor_mm": {"default": 859.46},
    "num_detector_pixels": {"flag": "--detector-pixels", "default": 768},
    "detector_pitch_mm": {"default": 1.502864583},
}


class Body(StrEnum):
    """What can be simulated beside a phantom."""

    LOG = "log"
    LOG_WITH_PHANTOM = "log-with-phantom"


class ExportTarget(StrEnum):
    """Toolkits that a geometry can be written for."""

    ASTRA = "astra"
    ODL = "odl"
    CIL = "cil"
    RTK = "rtk"


class Position(Contract):
    """A point of the plane that is scanned, in mm."""

    x: CoordinateMm = 0.0
    y: CoordinateMm = 0.0


Numbers = TypeVar("Numbers", GivenTheta, Position)
DEGREES = "deg"


class ScanOptions(UnregisteredScanOptions):
    """A scan's file as the command line gives it."""

    angles_file: Path | None = Field(None, description="Text file, one view's angle in degrees a line.")


def scan_source(path: Path, options: ScanOptions, *, views: int | None, rows: str | None) -> ScanSource:
    """The scan of a file and its flags."""
    return ScanSource(path, options, given_angles(options.angles_deg, options.angles_file), views, rows)


@dataclass(frozen=True)
class Pictures:
    """Where pictures of a volume are written: its middle slice, slices along it, its side, the curve of alpha."""

    middle: Path | None
    mosaic: Path | None
    side: Path | None
    alpha_curve: Path | None


@dataclass(frozen=True)
class PhantomSource:
    """A phantom by the name of a built-in one or by its file, and the width of a picture."""

    text: str
    width_mm: float | None

    def __post_init__(self) -> None:
        """Refuse a width that is missing or belongs to nothing."""
        if self.is_built_in and self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a built-in phantom has its size.")
        if self.is_drawing and self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a drawing is in mm already.")
        if not (self.is_built_in or self.is_drawing) and self.width_mm is None:
            raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm.")

    @property
    def path(self) -> Path:
        """Of the file."""
        return Path(self.text)

    @property
    def is_built_in(self) -> bool:
        """Whether it is one of the published phantoms."""
        return self.text in BUILT_IN_PHANTOMS

    @property
    def is_drawing(self) -> bool:
        """Whether the file is JSON."""
        return not self.is_built_in and self.path.suffix.lower() == ".json"


@dataclass(frozen=True)
class ThetaSource:
    """A geometry by its numbers."""

    theta: Theta
    rotation: Rotation
    source_to_cor_mm: float


@dataclass(frozen=True)
class CalibrationSource:
    """A geometry by the file of a calibration; a constant given beside it must agree."""

    path: Path
    source_to_cor_mm: float | None


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


def theta_of(text: str) -> Theta:
    """Theta from five numbers with commas between, angles also in degrees as 146.1deg (a parser of Typer's)."""
    angles = {"initial_angle_rad": _angle_rad, "detector_tilt": _slope}
    return _numbers(text, GivenTheta, "five numbers a,r,h,h,t", angles)


def position_of(text: str) -> Position:
    """A position from X,Y (a parser of Typer's)."""
    return _numbers(text, Position, "X,Y")


def coordinates_of(text: str) -> tuple[float, float]:
    """X and Y from X,Y (a parser of Typer's)."""
    position = position_of(text)
    return position.x, position.y


def _angle_rad(text: str) -> float:
    """In radians, unless the unit says degrees."""
    return math.radians(float(text.removesuffix(DEGREES))) if text.endswith(DEGREES) else float(text)


def _slope(text: str) -> float:
    """A slope, unless the unit says degrees."""
    return math.tan(_angle_rad(text)) if text.endswith(DEGREES) else float(text)


def _numbers(
    text: str,
    contract: type[Numbers],
    form: str,
    read: Mapping[str, Callable[[str], float]] = MappingProxyType({}),
) -> Numbers:
    try:
        written = dict(zip(field_names(contract), text.split(","), strict=True))
        numbers = {name: read.get(name, float)(number) for name, number in written.items()}
        return TypeAdapter(contract).validate_python(numbers)
    except ValueError as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        if first is not None and first["type"] in OUT_OF_BOUNDS:
            name = str(first["loc"][0])
            first["input"] = written[name]
            raise typer.BadParameter(f"{name} {sentence(first, contract)}.") from error
        raise typer.BadParameter(f"must be {form}, not {text!r}.") from error


def listed(texts: list[str] | None) -> list[str]:
    """Split what is given with commas between (a callback of Typer's)."""
    return [part.strip() for text in texts or () for part in text.split(",")]


def job_kinds(texts: list[str] | None) -> list[str]:
    """Split kinds of jobs, and refuse what is none (a callback of Typer's)."""
    kinds = listed(texts)
    for kind in kinds:
        if kind not in set(JobKind):
            raise typer.BadParameter(f"{kind!r} is no kind of job: {', '.join(JobKind)}.")
    return kinds


def one_number(text: str) -> float:
    """The number; what is not one is refused (a parser of Typer's)."""
    try:
        number = float(text)
    except ValueError as error:
        msg = f"{text!r} is not one number: pixels are square, and one number says both sides."
        raise typer.BadParameter(msg) from error
    return int(number) if number.is_integer() else number


def writable(path: Path | None) -> Path | None:
    """Refuse a file in a folder that does not exist, before long work is done for it (a callback of Typer's)."""
    if path is not None and not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"there is no folder {str(path.parent)!r} to write {path.name!r} into.")
    return path


def phantom(text: str) -> str:
    """Refuse what is neither a built-in phantom nor a file (a callback of Typer's)."""
    if text not in BUILT_IN_PHANTOMS and not Path(text).is_file():
        raise typer.BadParameter(f"must be {', '.join(BUILT_IN_PHANTOMS)} or an existing file, not {text!r}.")
    return text


def phantoms(texts: list[str]) -> list[str]:
    """Each of them (a callback of Typer's)."""
    return [phantom(text) for text in texts]


def body(text: str) -> str:
    """A phantom or a log (a callback of Typer's)."""
    return text if text in set(Body) else phantom(text)


def phantom_names() -> list[str]:
    """What a shell completes."""
    return list(BUILT_IN_PHANTOMS)


def body_names() -> list[str]:
    """What a shell completes."""
    return [*phantom_names(), *(each.value for each in Body)]


def picture(description: str) -> OptionInfo:
    """The flag of a picture that is written."""
    found: OptionInfo = typer.Option(metavar="OUT.png", dir_okay=False, callback=writable, help=description)
    return found


ROWS = {"metavar": "A:B"}
STEPPED_ROWS = {"metavar": "A:B[:STEP]"}
FIELDS = {"metavar": "FILE", "exists": True}
ScanFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCAN",
        exists=True,
        help="The scan: HDF5 (NXtomo, Data Exchange), TIFF, a folder or a ZIP of TIFFs, NPY, NPZ or MAT.",
    ),
]
AnglesDeg = Annotated[str | None, option(ScanFileOptions, "angles_deg", metavar="START:STEP")]
AnglesFile = Annotated[Path | None, option(ScanOptions, "angles_file", exists=True, dir_okay=False)]
ScanFlags = Annotated[
    ScanOptions,
    Flags(
        angles_deg={"metavar": "START:STEP"},
        angles_file={"exists": True, "dir_okay": False},
        flats=FIELDS,
        darks=FIELDS,
    ),
]
FlatsFile = Annotated[Path | None, option(ScanOptions, "flats", **FIELDS)]
DarksFile = Annotated[Path | None, option(ScanOptions, "darks", **FIELDS)]
SourceToCor = Annotated[float, option(ScannerConstants, "source_to_cor_mm")]
PhantomText = Annotated[
    str,
    typer.Option(
        "--phantom",
        metavar="NAME|FILE",
        callback=phantom,
        autocompletion=phantom_names,
        help=f"{', '.join(BUILT_IN_PHANTOMS)}, a drawing FILE.json, or a picture FILE.png, bright where wood is.",
    ),
]
PhantomWidth = Annotated[
    float | None, option(PhantomPicture, "width_mm", help="Width of a phantom's PNG, the whole picture.")
]
ThetaFlag = typer.Option(
    parser=theta_of,
    metavar="a,r,h,h,t",
    help="alpha0 (as 146.1deg, or rad), r_D, h_S, h_D (mm), alpha_D (as 15.7deg, or a slope), separated by commas.",
)
SourceToCorOfTheta = Annotated[
    float | None, option(ScannerConstants, "source_to_cor_mm", help="r_S, with --theta; a calibration carries it.")
]
RotationOfTheta = Annotated[Rotation | None, option(ReconstructionAsk, "rotation")]
CalibrationFlag = typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help=CALIBRATION_HELP)
Result = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="OUT", dir_okay=False, callback=writable, help="The file that is written."),
]
ReportFlag = typer.Option(
    metavar="OUT.html",
    dir_okay=False,
    callback=writable,
    help="Write a report: OUT.html is a page that prints on A4, OUT.png one picture.",
)
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]
