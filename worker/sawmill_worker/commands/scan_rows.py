"""A scan for a command: its rows as they are needed, never all of them in memory unless all are asked for."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pydantic import ValidationError

from sawmill_worker.commands.options import ScanSaid, complaint
from sawmill_worker.commands.terminal import part_of
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.preparing import PrepareOptions
from sawmill_worker.files.scan_reader import OpenScan, open_scan
from sawmill_worker.readers.own_scan import is_own_scan
from sawmill_worker.readers.reading import reading_scan
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.prepare import Stack, prepare_scan
from sawmill_worker.use_cases.room import memory_available
from sawmill_worker.use_cases.selection import chosen_rows, chosen_views
from sawmill_worker.vocabulary import DataKind, Progress, ProgressCallback, RowAlignment

# Of the free memory, for all rows that are asked for; the rest is for what is made of them.
MEMORY_SHARE = 0.9
# Of a command's progress, for reading and preparing.
PREPARING_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class ScanRows:
    """The rows and views asked for, read as they are needed.

    Attributes
    ----------
    read : callable
        (views, rows, detector) float32 line integrals of the rows start..stop of those asked for.
    rows, row_step
        The first row, the one after the last, and every which of them was asked for.
    report : callable
        Told of the progress from here on.
    """

    read: Callable[[int, int], Stack]
    angles_rad: FloatArray
    rows: tuple[int, int]
    row_step: int
    scanner: ScannerConstants
    counts: bool
    sha256: str
    remarks: tuple[str, ...]
    report: ProgressCallback

    def stack(self) -> Stack:
        """All of them (views, rows, detector); refused where they do not fit into the free memory."""
        rows, free = len(range(*self.rows, self.row_step)), int(MEMORY_SHARE * memory_available())
        needed = 4 * self.angles_rad.size * rows * self.scanner.num_detector_pixels
        if needed > free:
            raise refused(
                "too-large", f"{rows} rows need {needed} bytes in memory and {free} are free; ask for fewer with --rows"
            )
        return self.read(0, rows)


@contextmanager
def open_rows(
    said: ScanSaid, *, source_to_cor_mm: float, report: ProgressCallback, beside: Path | None = None
) -> Iterator[ScanRows]:
    """Open a scan and take the rows and views asked for.

    A scan of line integrals that this product wrote is read as it is; anything else, and a scan of which something is
    said that its file must be held against, is prepared into such a file, in a temporary folder.

    Parameters
    ----------
    beside : Path, optional
        A file whose folder holds that temporary folder; by default it is where the system keeps its own.

    Raises
    ------
    UnreadableScan, CountsError, RowsError, JobFailure
        The file, or what is said of it, cannot be used.
    """
    report(Progress(fraction=0.0, stage="read"))
    opened = (
        _own_rows(said, source_to_cor_mm, report)
        if _speaks_for_itself(said)
        else _prepared_rows(said, source_to_cor_mm, report, beside)
    )
    with opened as rows:
        yield rows


def _speaks_for_itself(said: ScanSaid) -> bool:
    """Whether nothing is said beside the file that would have to be compared with it or done to it."""
    silent = said.dataset is None and said.angles is None and said.row_pitch_mm is None
    if not (silent and said.data is DataKind.LINE_INTEGRALS and said.prepare == PrepareOptions()):
        return False
    if not is_own_scan(said.path):
        return False
    with open_scan(said.path) as scan:
        return said.detector_pitch_mm in {None, scan.detector_pitch_mm}


@contextmanager
def _own_rows(said: ScanSaid, source_to_cor_mm: float, report: ProgressCallback) -> Iterator[ScanRows]:
    with open_scan(said.path) as scan:
        counts = scan.air_level is not None
        yield _rows_of(scan, said, source_to_cor_mm, scan.angles_rad, report, counts=counts)


@contextmanager
def _prepared_rows(
    said: ScanSaid, source_to_cor_mm: float, report: ProgressCallback, beside: Path | None
) -> Iterator[ScanRows]:
    folder = None if beside is None else beside.absolute().parent
    with TemporaryDirectory(prefix=".sawmill-", dir=folder) as temporary:
        path = Path(temporary) / "scan.h5"
        reading = reading_scan(
            said.path,
            counts=said.data is DataKind.COUNTS,
            dataset=said.dataset,
            angles_deg=said.angles,
            detector_pitch_mm=said.detector_pitch_mm,
            row_pitch_mm=said.row_pitch_mm,
            rows_missing=said.prepare.align_rows is not RowAlignment.OFF,
            free_bytes=memory_available(),
        )
        with reading as read:
            if read.detector_pitch_mm is None:
                raise refused(
                    "detector-pitch-missing", "the file carries no detector pitch; give it as --detector-pitch-mm"
                )
            prepared = prepare_scan(
                read,
                said.prepare,
                path,
                detector_pitch_mm=read.detector_pitch_mm,
                report=part_of(report, 0.0, PREPARING_SHARE),
            )
        left = part_of(report, PREPARING_SHARE, 1.0)
        with open_scan(path) as scan:
            yield _rows_of(
                scan, said, source_to_cor_mm, read.angles_rad, left, counts=read.counts, remarks=prepared.remarks
            )


def _rows_of(
    scan: OpenScan,
    said: ScanSaid,
    source_to_cor_mm: float,
    angles_rad: FloatArray,
    report: ProgressCallback,
    *,
    counts: bool,
    remarks: tuple[str, ...] = (),
) -> ScanRows:
    all_views, all_rows, cells = scan.shape
    rows, views = range(all_rows)[chosen_rows(said.rows, all_rows)], chosen_views(said.views, all_views)

    def read(start: int, stop: int) -> Stack:
        block = scan.rows(rows[start:stop], views)
        finite = np.isfinite(block).all(axis=(0, 2))
        if not finite.all():
            row = rows[start + int(np.argmin(finite))]
            raise refused("not-finite", f"row {row} of the scan holds values that are no finite numbers; mend it")
        return block

    return ScanRows(
        read=read,
        angles_rad=angles_rad[views],
        rows=(rows.start, rows.stop),
        row_step=rows.step,
        scanner=_scanner(source_to_cor_mm, cells, scan.detector_pitch_mm, scan.row_pitch_mm),
        counts=counts,
        sha256=_sha256(said.path),
        remarks=remarks,
        report=report,
    )


def _scanner(r_s: float, cells: int, pitch: float, row_pitch: float | None) -> ScannerConstants:
    """The scanner's constants, as far as the file and the flags tell them; refused where no scanner has such."""
    try:
        return ScannerConstants(
            source_to_cor_mm=r_s, num_detector_pixels=cells, detector_pitch_mm=pitch, row_pitch_mm=row_pitch
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise refused("wrong-shape", f"the file's {first['loc'][0]} is {first['input']}: {complaint(error)}") from error


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
