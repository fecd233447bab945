"""A scan without a service, for commands and notebooks: rows are read when they are needed."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from sawmill_calibration.capacity import memory_available
from sawmill_calibration.failures import refused
from sawmill_calibration.scans.prepare import Stack, prepare_scan
from sawmill_calibration.scans.scan_source import ScanSource, links_offered
from sawmill_calibration.scans.selection import chosen_rows, chosen_views
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.preparing import PrepareOptions
from sawmill_formats.input.own.scan import is_own_scan
from sawmill_formats.input.reading import reading_scan
from sawmill_formats.output.scan_reader import OpenScan, open_scan
from sawmill_formats.reading_apart import read_apart
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DataKind, Progress, ProgressCallback, RowAlignment

# Share of the free memory for all requested rows; the rest is for results computed from the rows.
MEMORY_SHARE = 0.9
# Share of the progress for reading and preparing.
PREPARING_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class ScanRows:
    """The requested rows and views, read when they are needed.

    Attributes
    ----------
    read : callable
        Returns (views, rows, detector) float32 line integrals of the rows start..stop of the requested rows; NaN in
        every cell of rows that a view lacks.
    read_row : callable
        Returns (views, detector) float32 of any row of the scan, requested or not; NaN in views that lack the row.
    usable_rows : (first, after the last)
        The rows that enough views have.
    rows, row_step
        The first row, the row after the last, and the step between requested rows.
    on_progress : callable
        Called with the progress of the work after reading.
    deviations : (views, rows, detector) float32, or None
        Standard deviations of the requested rows; None if the scan has none.
    """

    read: Callable[[int, int], Stack]
    read_row: Callable[[int], NDArray[np.float32]]
    usable_rows: tuple[int, int]
    angles_rad: FloatArray
    rows: tuple[int, int]
    row_step: int
    scanner: ScannerConstants
    counts: bool
    sha256: str
    remarks: tuple[str, ...]
    on_progress: ProgressCallback
    deviations: Stack | None = None
    saturated_share: float = 0.0

    def stack(self) -> Stack:
        """Read all requested rows (views, rows, detector); refuse rows that do not fit into the free memory."""
        rows, free = len(range(*self.rows, self.row_step)), int(MEMORY_SHARE * memory_available())
        needed = 4 * self.angles_rad.size * rows * self.scanner.num_detector_pixels
        if needed > free:
            raise refused(
                "too-large", f"{rows} rows need {needed} bytes in memory and {free} are free; ask for fewer with --rows"
            )
        return self.read(0, rows)


@contextmanager
def open_rows(
    source: ScanSource, *, source_to_cor_mm: float, on_progress: ProgressCallback, beside: Path | None = None
) -> Iterator[ScanRows]:
    """Open a scan and select the requested rows and views.

    A scan of line integrals that this product wrote is read directly. Any other scan, and a scan with flags that must
    be compared with the file, is first prepared into such a file in a temporary folder.

    Parameters
    ----------
    beside : Path, optional
        A file whose folder holds the temporary folder; by default the system's temporary folder is used.

    Raises
    ------
    UnreadableScan, CountsError, RowsError, JobFailure
        The file, or a value given for it, cannot be used.
    """
    on_progress(Progress(fraction=0.0, stage="read"))
    options = source.options
    read_apart(source.path, options.flats, options.darks, follow_links=options.follow_links)
    opened = (
        _own_rows(source, source_to_cor_mm, on_progress)
        if _needs_no_preparing(source)
        else _prepared_rows(source, source_to_cor_mm, on_progress, beside)
    )
    with opened as rows:
        yield rows


def _needs_no_preparing(source: ScanSource) -> bool:
    """Return whether no flag must be compared with the file or applied to it."""
    options = source.options
    of_file = (options.dataset, source.angles, options.row_pitch_mm, options.averaged_rows, options.axes)
    beside = (*of_file, options.flats, options.darks)
    bare = all(given is None for given in beside)
    if not (
        bare
        and not options.transpose
        and options.data is DataKind.LINE_INTEGRALS
        and source.prepare == PrepareOptions()
    ):
        return False
    if not is_own_scan(source.path):
        return False
    with open_scan(source.path) as scan:
        return options.detector_pitch_mm in {None, scan.detector_pitch_mm}


@contextmanager
def _own_rows(source: ScanSource, source_to_cor_mm: float, on_progress: ProgressCallback) -> Iterator[ScanRows]:
    with open_scan(source.path) as scan:
        counts = scan.air_level is not None
        yield _rows_of(scan, source, source_to_cor_mm, scan.angles_rad, on_progress, counts=counts)


@contextmanager
def _prepared_rows(
    source: ScanSource, source_to_cor_mm: float, on_progress: ProgressCallback, beside: Path | None
) -> Iterator[ScanRows]:
    folder = None if beside is None else beside.absolute().parent
    with TemporaryDirectory(prefix=".sawmill-", dir=folder) as temporary:
        path = Path(temporary) / "scan.h5"
        reading = reading_scan(
            source.path,
            counts=source.options.data is DataKind.COUNTS,
            dataset=source.options.dataset,
            angles_deg=source.angles,
            detector_pitch_mm=source.options.detector_pitch_mm,
            row_pitch_mm=source.options.row_pitch_mm,
            rows_missing=source.prepare.align_rows is not RowAlignment.OFF,
            averaged_rows=source.options.averaged_rows,
            transpose=source.options.transpose,
            axes=source.options.axes,
            flats=source.options.flats,
            darks=source.options.darks,
            follow_links=source.options.follow_links,
            free_bytes=memory_available(),
        )
        with links_offered(followed=source.options.follow_links), reading as read:
            if read.detector_pitch_mm is None:
                hint = "" if read.unused is None else f"; it holds {read.unused}"
                raise refused(
                    "detector-pitch-missing",
                    f"the file carries no detector pitch; give it as --detector-pitch-mm{hint}",
                )
            prepared = prepare_scan(
                read,
                source.prepare,
                path,
                detector_pitch_mm=read.detector_pitch_mm,
                report=_part_of(on_progress, 0.0, PREPARING_SHARE),
            )
        rest = _part_of(on_progress, PREPARING_SHARE, 1.0)
        with open_scan(path) as scan:
            yield _rows_of(
                scan,
                source,
                source_to_cor_mm,
                read.angles_rad,
                rest,
                counts=read.counts,
                others=read.others,
                remarks=prepared.remarks,
            )


def _rows_of(
    scan: OpenScan,
    source: ScanSource,
    source_to_cor_mm: float,
    angles_rad: FloatArray,
    on_progress: ProgressCallback,
    *,
    counts: bool,
    others: tuple[Path, ...] = (),
    remarks: tuple[str, ...] = (),
) -> ScanRows:
    all_views, all_rows, _ = scan.shape
    rows = range(all_rows)[chosen_rows(source.rows, all_rows, scan.usable_rows)]
    views = chosen_views(source.views, all_views, scan.views_left_out)
    lacking = None if scan.present is None else ~scan.present[views]

    def read(start: int, stop: int) -> Stack:
        block = scan.rows(rows[start:stop], views)
        usable = np.isfinite(block).all(axis=2)
        if lacking is not None:
            usable |= lacking[:, rows.start : rows.stop : rows.step][:, start:stop]
        finite = usable.all(axis=0)
        if not finite.all():
            row = rows[start + int(np.argmin(finite))]
            raise refused("not-finite", f"row {row} of the scan holds values that are no finite numbers; mend it")
        return block

    def read_row(row: int) -> NDArray[np.float32]:
        return scan.rows(range(row, row + 1), views)[:, 0]

    return ScanRows(
        read=read,
        read_row=read_row,
        usable_rows=scan.usable_rows or (0, all_rows),
        angles_rad=angles_rad[views],
        rows=(rows.start, rows.stop),
        row_step=rows.step,
        scanner=_scanner(source_to_cor_mm, scan),
        counts=counts,
        sha256=_sha256([source.path, *others]),
        remarks=remarks,
        on_progress=on_progress,
        deviations=scan.deviations_of(rows, views),
        saturated_share=scan.saturated_share,
    )


def _scanner(r_s: float, scan: OpenScan) -> ScannerConstants:
    """Return the scanner's constants, as far as file and flags give them; refuse constants that no scanner has."""
    try:
        return ScannerConstants(
            source_to_cor_mm=r_s,
            num_detector_pixels=scan.shape[2],
            detector_pitch_mm=scan.detector_pitch_mm,
            detector_modules=scan.detector_modules,
            row_pitch_mm=scan.row_pitch_mm,
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise refused(
            "out-of-range", f"the file's {first['loc'][0]} is {first['input']}: {complaint(error)}"
        ) from error


def _sha256(paths: Sequence[Path]) -> str:
    """Compute the checksum of a file; for several files, of their hexadecimal checksums one after the other."""
    digests = [_sha256_of_file(path) for path in paths if path.is_file()]
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def _sha256_of_file(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _part_of(on_progress: ProgressCallback, start: float, stop: float) -> ProgressCallback:
    """Return a callback that maps the progress of a part of the work to a range of the progress of all work."""

    def on_part(progress: Progress) -> None:
        on_progress(replace(progress, fraction=start + (stop - start) * progress.fraction))

    return on_part
