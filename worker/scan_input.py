"""INPUT of the command line: a scan file and what is said of it (DESIGN section 8)."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from worker.contracts.base import DataKind, Rows
from worker.contracts.geometry import ScannerConstants
from worker.formats.angles import AnglesGiven, parse_angles, read_angles_file
from worker.formats.errors import UnreadableScan
from worker.formats.reading import read_scan
from worker.tasks.failures import refused
from worker.tasks.line_integrals import Stack, as_line_integrals
from worker.tasks.selection import chosen_rows, chosen_views
from worker.tomography.geometry import FloatArray

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
Views = Annotated[int | None, typer.Option(min=3, help="Use every (total / VIEWS)-th view.")]
RowsText = Annotated[
    str | None, typer.Option("--rows", metavar="A:B", help="Detector rows, the first included, the last not.")
]
SourceToCor = Annotated[float, typer.Option("--source-to-cor-mm", min=0.0, help="r_S, source to centre of rotation.")]
DetectorPitch = Annotated[
    float | None,
    typer.Option(
        "--detector-pitch-mm", min=0.0, help="Distance between detector cells; needed where the file does not carry it."
    ),
]
RowPitch = Annotated[float | None, typer.Option("--row-pitch-mm", min=0.0, help="Distance between detector rows.")]


@dataclass(frozen=True)
class ScanInput:
    """The scan as it is used: line integrals (views, rows, detector) and each view's angle."""

    stack: Stack
    angles_rad: FloatArray
    rows: tuple[int, int]
    scanner: ScannerConstants
    counts: bool
    sha256: str


def given_angles(angles_deg: str | None, angles_file: Path | None) -> AnglesGiven | None:
    """The angles of the flags; giving both is wrong use."""
    if angles_deg is not None and angles_file is not None:
        raise typer.BadParameter("give --angles-deg or --angles-file, not both")
    try:
        if angles_file is not None:
            return read_angles_file(angles_file)
        return None if angles_deg is None else parse_angles(angles_deg)
    except UnreadableScan as error:
        raise typer.BadParameter(str(error)) from error


def load(
    path: Path,
    *,
    data: DataKind,
    dataset: str | None,
    angles: AnglesGiven | None,
    views: int | None,
    rows: Rows | None,
    source_to_cor_mm: float,
    detector_pitch_mm: float | None,
    row_pitch_mm: float | None,
) -> ScanInput:
    """Read a scan and take the rows and views asked for.

    Raises
    ------
    UnreadableScan, CountsError, JobFailure
        The file, or what is said of it, cannot be used.
    """
    read = read_scan(
        path,
        counts=data is DataKind.COUNTS,
        dataset=dataset,
        angles_deg=angles,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
    )
    if read.detector_pitch_mm is None:
        raise refused("detector-pitch-missing", "the file carries no detector pitch; give it as --detector-pitch-mm")
    stack, _, _ = as_line_integrals(read)
    all_views, all_rows, cells = stack.shape
    chosen, which = chosen_rows(rows, all_rows), chosen_views(views, all_views)
    return ScanInput(
        stack=np.ascontiguousarray(stack[which, chosen]),
        angles_rad=read.angles_rad[which],
        rows=(chosen.start, chosen.stop),
        scanner=ScannerConstants(
            source_to_cor_mm=source_to_cor_mm,
            num_detector_pixels=cells,
            detector_pitch_mm=read.detector_pitch_mm,
            row_pitch_mm=read.row_pitch_mm,
        ),
        counts=read.counts,
        sha256=_sha256(path),
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
