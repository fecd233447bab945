"""Rows of a scan that a calibration, a drift check or a reconstruction works on, read when they are needed."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from sawmill_calibration.failures import memory_available, refused
from sawmill_calibration.scans.prepare import Stack, prepare_scan
from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scans import PrepareOptions, UnregisteredScanOptions
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AnglesGiven
from sawmill_formats.input.own import is_own_scan
from sawmill_formats.input.reading import reading_scan
from sawmill_formats.output.scan_reader import OpenScan, open_scan
from sawmill_formats.reading_apart import read_apart
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import DataKind, Progress, ProgressCallback, RowAlignment


@dataclass(frozen=True)
class ScanSource:
    """A scan's file, the options of reading, and the selection of views and rows."""

    path: Path
    options: UnregisteredScanOptions
    angles: AnglesGiven | None = None
    views: int | None = None
    rows: str | None = None
    turns: bool = True  # False: the views are passages through a fixed pair
    uploaded: bool = False  # True in a confined process: it starts no other one, and its refusals name no flags


@contextmanager
def links_offered(*, followed: bool) -> Iterator[None]:
    """Name the flag that follows links where a file is refused for its links; a refused upload does not name it."""
    try:
        yield
    except UnreadableScan as error:
        if error.code != "external-storage" or followed:
            raise
        raise UnreadableScan(error.code, f"{error}, or read the other files too by --follow-links") from error


def chosen_rows(rows: str | None, available: int, usable: tuple[int, int] | None = None) -> slice:
    """Parse rows A:B or A:B:STEP, or select all usable (first, after the last); refuse rows that the scan lacks."""
    first, last = usable or (0, available)
    if rows is None:
        return slice(first, last)
    selected = parse_rows(rows)
    if selected.stop > available:
        raise refused("rows-outside", f"rows {rows} were asked for, but the scan has rows 0:{available}")
    if selected.start < first or selected.stop > last:
        raise refused(
            "rows-outside",
            f"rows {rows} were asked for, but too many views lost some of them: rows {first}:{last} can be used",
        )
    return selected


def chosen_views(views: int | None, available: int, left_out: Sequence[int] = ()) -> NDArray[np.intp]:
    """Return indices of every (usable / views)-th usable view, or of all of them; refuse more views than usable."""
    usable = np.setdiff1d(np.arange(available), left_out)
    if views is None:
        return usable
    if views > usable.size:
        corrupt = f" of which {len(left_out)} are corrupt" if left_out else ""
        raise refused("views-too-many", f"{views} views were asked for, but the scan has {available}{corrupt}")
    return usable[np.arange(views) * usable.size // views]


# Share of the free memory for all requested rows; the rest is for results computed from the rows.
MEMORY_SHARE = 0.9
# Share of the progress for reading and preparing.
PREPARING_SHARE = 0.5


def unreported(_: Progress) -> None:
    """Ignore progress."""


@dataclass(frozen=True, eq=False)
class ScanRows:
    """The requested rows and views of a scan: what jobs, commands and Python users give to the library."""

    # Returns (views, rows, detector) float32 line integrals of the rows start..stop of the requested rows; NaN in every
    # cell of rows that a view lacks.
    read: Callable[[int, int], Stack]
    # Returns (views, detector) float32 of any row of the scan, requested or not; NaN in views that lack the row.
    read_row: Callable[[int], NDArray[np.float32]]
    usable_rows: tuple[int, int]  # (first, after the last): the rows that enough views have
    angles_rad: FloatArray  # (views,) float64
    # rows, row_step: the first row, the row after the last, and the step between requested rows.
    rows: tuple[int, int]
    row_step: int
    scanner: ScannerConstants
    counts: bool  # True if the line integrals were made from counts
    sha256: str
    remarks: tuple[str, ...]  # the steps that prepared the data
    on_progress: ProgressCallback = unreported  # called with the progress of the work after reading
    rows_named: bool = False  # True if somebody named the rows; else the phantom's rows are found in a calibration
    averaged_rows: int | None = None  # number of rows whose mean was sent; None if the rows themselves were sent
    # (views, rows, detector) float32: standard deviations of the requested rows; None if the scan has none.
    deviations: Stack | None = None
    saturated_share: float = 0.0  # share of the detector's cells that are saturated, as far as it is known
    used_views: NDArray[np.bool_] | None = None  # (all views of the scan,): the views that are used; None: all

    def stack(self) -> Stack:
        """Read all requested rows (views, rows, detector); refuse rows that do not fit into the free memory."""
        rows, free = len(range(*self.rows, self.row_step)), int(MEMORY_SHARE * memory_available())
        needed = 4 * self.angles_rad.size * rows * self.scanner.num_detector_pixels
        if needed > free:
            raise refused("too-large", f"{rows} rows need {needed} bytes in memory and {free} are free; ask for fewer")
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
    if not source.uploaded:
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
    bare = all(value is None for value in (*of_file, options.flats, options.darks)) and not options.transpose
    unprepared = all(getattr(options, name) == field.default for name, field in PrepareOptions.model_fields.items())
    if not (bare and unprepared and options.data is DataKind.LINE_INTEGRALS and is_own_scan(source.path)):
        return False
    with open_scan(source.path) as scan:
        return options.detector_pitch_mm in {None, scan.detector_pitch_mm}


def of_file(options: Any) -> dict[str, Any]:  # noqa: ANN401 - of a scan, or of an inspection, which needs less
    """Return the parameters of `reading_contents` that `options` states by its fields, with the free memory."""
    stated = {
        name: getattr(options, name) for name in ("dataset", "transpose", "axes", "flats", "darks", "follow_links")
    }
    return {"counts": options.data is DataKind.COUNTS, "free_bytes": memory_available(), **stated}


@contextmanager
def _own_rows(source: ScanSource, source_to_cor_mm: float, on_progress: ProgressCallback) -> Iterator[ScanRows]:
    with open_scan(source.path) as scan:
        yield rows_of(
            scan,
            _scanner(source_to_cor_mm, scan, source.options),
            rows=source.rows,
            views=source.views,
            counts=scan.air_level is not None,
            sha256=_sha256([source.path]),
            on_progress=on_progress,
        )


@contextmanager
def _prepared_rows(
    source: ScanSource, source_to_cor_mm: float, on_progress: ProgressCallback, beside: Path | None
) -> Iterator[ScanRows]:
    with TemporaryDirectory(prefix=".sawmill-", dir=None if beside is None else beside.absolute().parent) as temporary:
        path = Path(temporary) / "scan.h5"
        reading = reading_scan(
            source.path,
            **of_file(source.options),
            angles_deg=source.angles,
            detector_pitch_mm=source.options.detector_pitch_mm,
            row_pitch_mm=source.options.row_pitch_mm,
            rows_missing=source.options.align_rows is not RowAlignment.OFF,
            averaged_rows=source.options.averaged_rows,
            turns=source.turns,
        )
        with links_offered(followed=source.options.follow_links or source.uploaded), reading as read:
            if read.detector_pitch_mm is None:
                hint = "" if read.unused is None else f"; it holds {read.unused}"
                raise refused(
                    "detector-pitch-missing",
                    f"the file carries no detector pitch; give it as --detector-pitch-mm{hint}",
                )
            prepared = prepare_scan(
                read,
                source.options,
                path,
                detector_pitch_mm=read.detector_pitch_mm,
                report=part_of(on_progress, 0.0, PREPARING_SHARE),
            )
        with open_scan(path) as scan:
            opened = rows_of(
                scan,
                _scanner(source_to_cor_mm, scan, source.options),
                rows=source.rows,
                views=source.views,
                counts=read.counts,
                sha256=_sha256([source.path, *read.others]),
                remarks=prepared.remarks,
                averaged_rows=source.options.averaged_rows,
                on_progress=part_of(on_progress, PREPARING_SHARE, 1.0),
            )
            # The file's own angles, without the rounding to degrees.
            views = chosen_views(source.views, scan.shape[0], scan.views_left_out)
            yield replace(opened, angles_rad=read.angles_rad[views])


def rows_of(
    scan: OpenScan,
    scanner: ScannerConstants,
    *,
    rows: str | None,
    views: int | None,
    counts: bool,
    sha256: str,
    remarks: tuple[str, ...] = (),
    averaged_rows: int | None = None,
    on_progress: ProgressCallback = unreported,
) -> ScanRows:
    """Select rows A:B[:STEP] and a number of views of an open scan, all usable ones by default; or refuse them."""
    all_views, all_rows, _ = scan.shape
    selected = range(all_rows)[chosen_rows(rows, all_rows, scan.usable_rows)]
    used = chosen_views(views, all_views, scan.views_left_out)
    lacking = None if scan.present is None else ~scan.present[used]

    def read(start: int, stop: int) -> Stack:
        block = scan.rows(selected[start:stop], used)
        usable = np.isfinite(block).all(axis=2)
        if lacking is not None:
            usable |= lacking[:, selected.start : selected.stop : selected.step][:, start:stop]
        finite = usable.all(axis=0)
        if not finite.all():
            row = selected[start + int(np.argmin(finite))]
            raise refused("not-finite", f"row {row} of the scan holds values that are no finite numbers; mend it")
        return block

    return ScanRows(
        read=read,
        read_row=lambda row: scan.rows(range(row, row + 1), used)[:, 0],
        usable_rows=scan.usable_rows or (0, all_rows),
        angles_rad=scan.angles_rad[used],
        rows=(selected.start, selected.stop),
        row_step=selected.step,
        scanner=scanner,
        counts=counts,
        sha256=sha256,
        remarks=remarks,
        on_progress=on_progress,
        rows_named=rows is not None,
        averaged_rows=averaged_rows,
        deviations=scan.deviations_of(selected, used),
        saturated_share=scan.saturated_share,
        used_views=np.isin(np.arange(all_views), used),
    )


def _scanner(r_s: float, scan: OpenScan, options: UnregisteredScanOptions) -> ScannerConstants:
    """Return the scanner's constants, as far as file and flags give them; refuse constants that no scanner has."""
    try:
        return ScannerConstants(
            source_to_cor_mm=r_s,
            num_detector_pixels=scan.shape[2],
            detector_pitch_mm=scan.detector_pitch_mm,
            detector_modules=scan.detector_modules,
            detector_arc_radius_mm=options.detector_arc_radius_mm or scan.detector_arc_radius_mm,
            object_turns=options.object_turns,
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


def part_of(on_progress: ProgressCallback, start: float, stop: float) -> ProgressCallback:
    """Return a callback that maps the progress of a part of the work to a range of the progress of all work."""

    def on_part(progress: Progress) -> None:
        on_progress(replace(progress, fraction=start + (stop - start) * progress.fraction))

    return on_part
