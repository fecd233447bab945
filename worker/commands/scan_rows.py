"""A scan for `sawmill reconstruct`: row by row where the product wrote the file, else read as a whole."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from worker.commands.options import ScanSaid
from worker.commands.scan_input import load, scanner_of, sha256_of
from worker.contracts.base import DataKind
from worker.contracts.geometry import ScannerConstants
from worker.contracts.preparing import PrepareOptions
from worker.formats.scan_file import is_own_scan, open_scan
from worker.tasks.failures import refused
from worker.tasks.line_integrals import Stack
from worker.tasks.selection import chosen_rows, chosen_views
from worker.tomography.geometry import FloatArray
from worker.tomography.stack import ReadRows


@dataclass(frozen=True, eq=False)
class ScanRows:
    """The rows and views asked for, read as they are needed.

    Attributes
    ----------
    read : callable
        (views, rows, detector) float32 line integrals of the rows start..stop of those asked for.
    rows, row_step
        The first row, the one after the last, and every which of them was asked for.
    """

    read: ReadRows
    angles_rad: FloatArray
    rows: tuple[int, int]
    row_step: int
    scanner: ScannerConstants
    counts: bool
    sha256: str
    remarks: tuple[str, ...]


@contextmanager
def open_rows(said: ScanSaid, *, source_to_cor_mm: float) -> Iterator[ScanRows]:
    """Open a scan and take the rows and views asked for.

    A scan of line integrals that this product wrote is never in memory as a whole; anything else, and a scan of which
    something is said that its file must be held against, is read by `load`.

    Raises
    ------
    UnreadableScan, CountsError, JobFailure
        The file, or what is said of it, cannot be used.
    """
    with (
        _own_rows(said, source_to_cor_mm) if _speaks_for_itself(said) else _loaded_rows(said, source_to_cor_mm) as rows
    ):
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
def _own_rows(said: ScanSaid, source_to_cor_mm: float) -> Iterator[ScanRows]:
    with open_scan(said.path) as scan:
        all_views, all_rows, cells = scan.shape
        rows, views = range(all_rows)[chosen_rows(said.rows, all_rows)], chosen_views(said.views, all_views)

        def read(start: int, stop: int) -> Stack:
            block = scan.rows(rows[start:stop], views)
            finite = np.isfinite(block).all(axis=(0, 2))
            if not finite.all():
                row = rows[start + int(np.argmin(finite))]
                raise refused("not-finite", f"row {row} of the scan holds values that are no finite numbers; mend it")
            return block

        yield ScanRows(
            read=read,
            angles_rad=scan.angles_rad[views],
            rows=(rows.start, rows.stop),
            row_step=rows.step,
            scanner=scanner_of(source_to_cor_mm, cells, scan.detector_pitch_mm, scan.row_pitch_mm),
            counts=scan.air_level is not None,
            sha256=sha256_of(said.path),
            remarks=(),
        )


@contextmanager
def _loaded_rows(said: ScanSaid, source_to_cor_mm: float) -> Iterator[ScanRows]:
    used = load(said, source_to_cor_mm=source_to_cor_mm)
    yield ScanRows(
        read=lambda start, stop: used.stack[:, start:stop],
        angles_rad=used.angles_rad,
        rows=used.rows,
        row_step=used.row_step,
        scanner=used.scanner,
        counts=used.counts,
        sha256=used.sha256,
        remarks=used.remarks,
    )
