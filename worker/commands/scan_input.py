"""INPUT of the command line: a scan file and what is said of it (DESIGN section 8)."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from worker.commands.options import ScanSaid, complaint
from worker.contracts.base import DataKind
from worker.contracts.geometry import ScannerConstants
from worker.contracts.preparing import RowAlignment
from worker.formats.reading import read_scan
from worker.tasks.failures import refused
from worker.tasks.line_integrals import Stack, as_line_integrals
from worker.tasks.room import memory_available
from worker.tasks.selection import chosen_rows, chosen_views
from worker.tomography.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class ScanInput:
    """The scan as it is used: line integrals (views, rows, detector) and each view's angle."""

    stack: Stack
    angles_rad: FloatArray
    rows: tuple[int, int]
    row_step: int
    scanner: ScannerConstants
    counts: bool
    sha256: str
    remarks: tuple[str, ...]


def load(said: ScanSaid, *, source_to_cor_mm: float) -> ScanInput:
    """Read a scan and take the rows and views asked for.

    Raises
    ------
    UnreadableScan, CountsError, JobFailure
        The file, or what is said of it, cannot be used.
    """
    read = read_scan(
        said.path,
        counts=said.data is DataKind.COUNTS,
        dataset=said.dataset,
        angles_deg=said.angles,
        detector_pitch_mm=said.detector_pitch_mm,
        row_pitch_mm=said.row_pitch_mm,
        rows_missing=said.prepare.align_rows is not RowAlignment.OFF,
        free_bytes=memory_available(),
    )
    if read.detector_pitch_mm is None:
        raise refused("detector-pitch-missing", "the file carries no detector pitch; give it as --detector-pitch-mm")
    prepared = as_line_integrals(read, said.prepare)
    all_views, all_rows, cells = prepared.stack.shape
    rows, views = chosen_rows(said.rows, all_rows), chosen_views(said.views, all_views)
    taken = prepared.stack[:, rows]
    scanner = scanner_of(source_to_cor_mm, cells, read.detector_pitch_mm, read.row_pitch_mm)
    return ScanInput(
        # All of it is taken without a second one.
        stack=np.ascontiguousarray(taken if views.size == all_views else taken[views]),
        angles_rad=read.angles_rad[views],
        rows=(rows.start, rows.stop),
        row_step=rows.step or 1,
        scanner=scanner,
        counts=read.counts,
        sha256=sha256_of(said.path),
        remarks=prepared.remarks,
    )


def scanner_of(r_s: float, cells: int, pitch: float, row_pitch: float | None) -> ScannerConstants:
    """The scanner's constants, as far as the file and the flags tell them; refused where no scanner has such."""
    try:
        return ScannerConstants(
            source_to_cor_mm=r_s, num_detector_pixels=cells, detector_pitch_mm=pitch, row_pitch_mm=row_pitch
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise refused("wrong-shape", f"the file's {first['loc'][0]} is {first['input']}: {complaint(error)}") from error


def sha256_of(path: Path) -> str:
    """Of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
