"""Flags that several commands share, also of phantoms, and checks of their use before any file is read."""
# ruff: noqa: PLC0415 - imports inside functions, so that a command's help need not load the readers of files

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import Field

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scans import ScanFileOptions, UnregisteredScanOptions
from sawmill_worker.commands.from_contract import Flags, option

if TYPE_CHECKING:
    from sawmill_calibration.scans.scan_rows import ScanSource
    from sawmill_formats.input.angles import AnglesGiven


from sawmill_contracts.phantoms import PhantomPicture
from sawmill_vocabulary import BUILT_IN_OUTLINES

# Flags of the scanner's constants, with the published scanner (arXiv 2206.14444) as the default.
PUBLISHED_SCANNER = {
    "source_to_cor_mm": {"default": 859.46},
    "num_detector_pixels": {"flag": "--detector-pixels", "default": 768},
    "detector_pitch_mm": {"default": 1.502864583},
    "detector_modules": None,
    "detector_waves_mm": None,
}


class ExportTarget(StrEnum):
    """Toolkits for which a geometry can be written."""

    VECTORS = "vectors"
    ASTRA = "astra"
    ODL = "odl"
    CIL = "cil"
    RTK = "rtk"


class ScanOptions(UnregisteredScanOptions):
    """Options of a scan's file on the command line."""

    angles_file: Path | None = Field(None, description="Text file, one view's angle in degrees a line.")


def scan_source(path: Path, options: ScanOptions, *, views: int | None, rows: str | None) -> "ScanSource":
    """Return the scan of a file and its flags."""
    from sawmill_calibration.scans.scan_rows import ScanSource

    return ScanSource(path, options, given_angles(options.angles_deg, options.angles_file), views, rows)


def given_angles(angles_deg: str | None, angles_file: Path | None) -> "AnglesGiven | None":
    """Return the angles of the flags; both flags together are wrong use."""
    from sawmill_formats.errors import UnreadableScan
    from sawmill_formats.input.angles import parse_angles, read_angles_file

    if angles_deg is not None and angles_file is not None:
        raise typer.BadParameter("give --angles-deg or --angles-file, not both.")
    try:
        if angles_file is not None:
            return read_angles_file(angles_file)
        return None if angles_deg is None else parse_angles(angles_deg)
    except UnreadableScan as error:
        raise typer.BadParameter(str(error)) from error


def writable(path: Path | None) -> Path | None:
    """Refuse a file in a folder that does not exist, before long work is done for the file (a Typer callback)."""
    if path is not None and not path.absolute().parent.is_dir():
        raise typer.BadParameter(f"there is no folder {str(path.parent)!r} to write {path.name!r} into.")
    return path


ROWS = {"metavar": "A:B"}
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
OF_READING: Mapping[str, Mapping[str, Any]] = {
    "angles_deg": {"metavar": "START:STEP"},
    "angles_file": {"exists": True, "dir_okay": False},
    "flats": FIELDS,
    "darks": FIELDS,
}
ScanFlags = Annotated[ScanOptions, Flags(**OF_READING)]
FlatsFile = Annotated[Path | None, option(ScanOptions, "flats", **FIELDS)]
DarksFile = Annotated[Path | None, option(ScanOptions, "darks", **FIELDS)]
SourceToCor = Annotated[float, option(ScannerConstants, "source_to_cor_mm")]
Result = Annotated[
    Path,
    typer.Option("--output", "-o", metavar="OUT", dir_okay=False, callback=writable, help="The file that is written."),
]
JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]


class PhantomShape(StrEnum):
    """Shapes other than a phantom that can be simulated."""

    LOG = "log"
    LOG_WITH_PHANTOM = "log-with-phantom"


def check_width(phantom: str, width_mm: float | None) -> None:
    """Refuse a picture without a width, and a width without a picture."""
    if phantom in BUILT_IN_OUTLINES and width_mm is not None:
        raise typer.BadParameter("--phantom-width-mm is for a picture; a built-in phantom has its size.")
    is_drawing = Path(phantom).suffix.lower() in {".json", ".h5"}
    if is_drawing and width_mm is not None:
        raise typer.BadParameter("--phantom-width-mm is for a picture; a drawing is in mm already.")
    if not (phantom in BUILT_IN_OUTLINES or is_drawing) and width_mm is None:
        raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm.")


def existing_phantom(text: str) -> str:
    """Refuse a text that is neither a built-in phantom nor a file (a Typer callback)."""
    if text not in BUILT_IN_OUTLINES and not Path(text).is_file():
        raise typer.BadParameter(f"must be {', '.join(BUILT_IN_OUTLINES)} or an existing file, not {text!r}.")
    return text


def existing_phantoms(texts: list[str]) -> list[str]:
    """Refuse any text that is neither a built-in phantom nor a file (a Typer callback)."""
    return [existing_phantom(text) for text in texts]


def body_or_phantom(text: str) -> str:
    """Refuse a text that is neither a phantom nor a log (a Typer callback)."""
    return text if text in set(PhantomShape) else existing_phantom(text)


def phantom_names() -> list[str]:
    """Return the phantoms that a shell completes."""
    return list(BUILT_IN_OUTLINES)


def body_names() -> list[str]:
    """Return the shapes and phantoms that a shell completes."""
    return [*phantom_names(), *(each.value for each in PhantomShape)]


PhantomText = Annotated[
    str,
    typer.Option(
        "--phantom",
        metavar="NAME|FILE",
        callback=existing_phantom,
        autocompletion=phantom_names,
        help=f"{', '.join(BUILT_IN_OUTLINES)}, a drawing FILE.json, a packed scan that holds one, or a picture "
        "FILE.png, bright where wood is.",
    ),
]
PhantomWidth = Annotated[
    float | None, option(PhantomPicture, "width_mm", help="Width of a phantom's PNG, the whole picture.")
]
