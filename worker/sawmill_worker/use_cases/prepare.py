"""A scan as it is read to the file that every job uses: line integrals, prepared as asked, in a bounded window."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.contracts.preparing import PrepareOptions
from sawmill_worker.files.scan_writer import NewScan, new_scan
from sawmill_worker.readers.canonical import CanonicalScan
from sawmill_worker.tomography.geometry import FloatArray
from sawmill_worker.tomography.preparing.missing_rows import CommonRows, RowShifts, present_rows
from sawmill_worker.tomography.preparing.preparation import Measures, Preparation
from sawmill_worker.tomography.preparing.preprocess import Exposure
from sawmill_worker.tomography.preparing.row_mass import RowMoments, shifts_by_mass
from sawmill_worker.use_cases.room import check_disk_for_scan
from sawmill_worker.vocabulary import AirCorrection, FaultyCells, Progress, ProgressCallback, RingRemoval, RowAlignment

Stack = NDArray[np.float32]

# Of samples in memory at a time, as float32; what is made of them, a row or a view at a time, comes on top.
WINDOW_BYTES = 128 * 2**20
# The source's drift since the flat fields, at most: counts a quarter lower everywhere show no air.
LARGEST_DRIFT = 0.3


@dataclass(frozen=True)
class PreparedScan:
    """What was made of a scan.

    Attributes
    ----------
    shape : (views, rows, detector)
    remarks : tuple of str
        What was done to the data, from reading on.
    """

    shape: tuple[int, int, int]
    remarks: tuple[str, ...]


def prepare_scan(
    read: CanonicalScan,
    options: PrepareOptions,
    output: Path,
    *,
    detector_pitch_mm: float,
    report: ProgressCallback,
    provenance: Mapping[str, str] | None = None,
    window_bytes: int = WINDOW_BYTES,
) -> PreparedScan:
    """A scan into a file: counts become line integrals, then faulty cells, air, rings and missing rows, as asked.

    Rows are treated as they are read where the file can be read row by row, and are read once more where it cannot;
    views that are laid over one another are read two times more. The file is there when all of it is.

    Parameters
    ----------
    read : CanonicalScan
        An open scan.
    output : Path
        The file that is written; `sawmill_worker.files.scan_reader` reads it.
    provenance : mapping of str to str, optional
        What the file is to say of where the data come from, beside the remarks.
    window_bytes : int
        Samples in memory at a time, as float32: at least what the file stores in one piece, one view, and one row of
        all views.

    Raises
    ------
    UnreadableScan, CountsError, RowsError
        The samples cannot be those of a scan, the counts are none, or the views' rows cannot be laid over one another.
    JobFailure, OSError
        The file does not fit on the disk, or cannot be written.
    """
    check_disk_for_scan(output.parent, read.shape)
    treatment, aligns = _Treatment(read, options), options.align_rows is not RowAlignment.OFF
    step_views, _ = read.block_shape(window_bytes)
    by_views = step_views < read.shape[0]
    again = by_views and treatment.needed
    telling = _Telling(report, read.shape, passes=1 + again + 2 * aligns)
    scan = new_scan(
        output,
        read.shape,
        angles_rad=read.angles_rad,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=read.row_pitch_mm,
        views_together=min(step_views, _within(window_bytes, read.shape[1:])) if by_views or aligns else None,
    )
    with scan as written:
        present = _copy(read, written.data, None if again else treatment, window_bytes, telling)
        if again:
            _treat(written.data, treatment, window_bytes, telling)
        level, remarks, shifts = treatment.air_level(), (*read.remarks, *treatment.remarks()), None
        if aligns:
            images = _Images(written.data, _within(window_bytes, read.shape[1:]), telling)
            shifts = _shifts(images, read.angles_rad, options.align_rows, treatment.of_object())
            _lay_over(written, images, CommonRows.of(present, shifts))
            rows = written.data.shape[1]
            remarks = (*remarks, _of_alignment(options.align_rows, shifts, rows, read.shape[1]))
            # Moved rows have left their flat fields behind: what a cell counts in air is then what it counts in most.
            level = None if level is None else np.tile(np.median(level, axis=0), (rows, 1))
        written.note(
            air_level=level,
            provenance={**(provenance or {}), "remarks": "\n".join(remarks)},
            row_shifts=None if shifts is None else shifts.rows,
        )
        return PreparedScan(written.data.shape, remarks)


class _Treatment:
    """What is done to any rows of a scan, and what was."""

    def __init__(self, read: CanonicalScan, options: PrepareOptions) -> None:
        _, rows, self._cells = read.shape
        self._exposure = None if read.flats is None else Exposure.of(read.flats, read.darks)
        self._measures = _measures(options, counts=read.counts)
        self._preparation = Preparation(self._measures, rows, self._cells)
        self._starved = 0

    @property
    def needed(self) -> bool:
        """Whether there is anything to do."""
        return self._exposure is not None or not self._measures.none

    def apply(self, stack: Stack, first_row: int) -> None:
        """Treat rows from `first_row` on (views, rows, detector), in place."""
        if self._exposure is not None:
            self._starved += self._exposure.to_line_integrals(stack, first_row)
        if not self._measures.none:
            self._preparation.treat(stack, first_row)

    def remarks(self) -> tuple[str, ...]:
        """What was done."""
        of_counts = () if self._exposure is None else self._exposure.remarks(self._starved)
        return of_counts if self._measures.none else (*of_counts, *self._preparation.done().remarks)

    def air_level(self) -> Stack | None:
        """(rows, detector) float32, of counts: mean flat less mean dark; 0 where a cell was bridged."""
        if self._exposure is None:
            return None
        return np.where(self._preparation.done().faulty, np.float32(0.0), self._exposure.air_level)

    def of_object(self) -> NDArray[np.bool_]:
        """The cells (cells,) that are not air in every row; all of them where no air was looked for."""
        air_cells = self._preparation.done().air_cells
        return np.ones(self._cells, bool) if air_cells.all() else ~air_cells


def _measures(options: PrepareOptions, *, counts: bool) -> Measures:
    by_kind = AirCorrection.VIEWS if counts else AirCorrection.OFF
    correction = by_kind if options.air is AirCorrection.AUTO else options.air
    bridging = options.faulty_cells is FaultyCells.BRIDGE or (options.faulty_cells is FaultyCells.AUTO and counts)
    return Measures(
        air=correction,
        largest_air_level=LARGEST_DRIFT if options.air is AirCorrection.AUTO else math.inf,
        bridge_faulty_cells=bridging,
        remove_rings=options.rings is RingRemoval.SORTING,
    )


class _Telling:
    """Turns samples done, in so many passes over a scan, into progress."""

    def __init__(self, report: ProgressCallback, shape: tuple[int, ...], *, passes: int) -> None:
        self._report, self._all, self._done = report, passes * math.prod(shape), 0

    def add(self, samples: int, stage: str) -> None:
        """So many more are done."""
        self._done += samples
        self._report(Progress(fraction=min(self._done / self._all, 1.0), stage=stage))


def _within(window_bytes: int, shape: tuple[int, ...]) -> int:
    """How many arrays of a shape fit into the window; one at least."""
    return max(1, window_bytes // (4 * math.prod(shape)))


def _copy(
    read: CanonicalScan, data: h5py.Dataset, treatment: _Treatment | None, window_bytes: int, telling: _Telling
) -> NDArray[np.bool_]:
    """Every sample into the dataset, treated where blocks hold all views; and which rows (views, rows) are there."""
    present = np.empty(read.shape[:2], bool)
    for block in read.blocks(window_bytes):
        present[block.views, block.rows] = present_rows(block.samples)
        if treatment is not None:
            treatment.apply(block.samples, block.rows.start)
        data[block.views, block.rows] = block.samples
        telling.add(block.samples.size, "read")
        del block  # before the next one is read
    return present


def _treat(data: h5py.Dataset, treatment: _Treatment, window_bytes: int, telling: _Telling) -> None:
    views, rows, cells = data.shape
    step = _within(window_bytes, (views, cells))
    for first in range(0, rows, step):
        block = data[:, first : first + step]
        treatment.apply(block, first)
        data[:, first : first + step] = block
        telling.add(block.size, "prepare")
        del block  # before the next one is read


@dataclass(frozen=True, eq=False)
class _Images:
    """All views (rows, cells) of a dataset, one after the other; about so many are read at a time, in whole chunks."""

    data: h5py.Dataset
    at_a_time: int
    telling: _Telling

    def __iter__(self) -> Iterator[Stack]:
        for block, _ in self.blocks():
            for image in block:
                yield image.copy()  # so that who keeps an image does not keep its block
            del block, image  # before the next one is read

    def blocks(self) -> Iterator[tuple[Stack, int]]:
        """(views, rows, cells), and the number of the first view."""
        chunk = self.data.chunks[0]
        step = max(1, self.at_a_time // chunk) * chunk
        for first in range(0, len(self.data), step):
            stop = min(first + step, len(self.data))
            yield self.data[first:stop], first
            self.telling.add((stop - first) * math.prod(self.data.shape[1:]), "align rows")


def _shifts(images: _Images, angles_rad: FloatArray, way: RowAlignment, of_object: NDArray[np.bool_]) -> RowShifts:
    if way is RowAlignment.PROFILE:
        return shifts_by_mass(RowMoments.of(images, of_object), angles_rad)
    # OpenCV takes half a second to import, and few scans need it.
    from sawmill_worker.tomography.preparing.matched_rows import shifts_by_features  # noqa: PLC0415

    return shifts_by_features(images, angles_rad)


def _lay_over(scan: NewScan, images: _Images, common: CommonRows) -> None:
    """Keep the common rows of each view."""
    rows = common.end - common.begin
    for block, first in images.blocks():
        for view, image in enumerate(block):
            block[view, :rows] = common.of_view(first + view, image)
        scan.data[first : first + len(block), :rows] = block[:, :rows]
        del block, image  # before the next one is read
    scan.keep_rows(rows)


def _of_alignment(way: RowAlignment, shifts: RowShifts, rows: int, rows_before: int) -> str:
    return (
        f"views laid over one another by their {way.value}: {rows} of {rows_before} rows are in all, "
        f"shifts 0 to {shifts.rows.max():.3g} {'whole ' if shifts.whole else ''}rows, standard deviation "
        f"{float(np.median(shifts.standard_deviation)):.2g}{'' if shifts.whole else '; resampled by cubic convolution'}"
    )
