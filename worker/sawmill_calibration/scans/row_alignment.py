"""Alignment, in the scan's file, of views that lost rows: a row keeps its number, and views may lack it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.preparing.row_shifts import RowsError, RowShifts, shifted
from sawmill_tomography.preparing.shifts_by_mass import RowMoments, shifts_by_mass
from sawmill_tomography.sinograms.air import find_air
from sawmill_tomography.sinograms.present_rows import Rows, present_rows, usable_rows
from sawmill_vocabulary import RowAlignment
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import PreparingMessage

Stack = NDArray[np.float32]

# Number of rows along the log in which cells of air are sought: a log tapers and bends.
AIR_ROWS = 9


@dataclass(frozen=True, eq=False)
class AlignedRows:
    """Shifts of the views, and rows (views, rows) and usable rows afterwards; mixed: of several detector rows."""

    shifts: RowShifts
    present: Rows
    usable: tuple[int, int]
    mixed: bool

    def remarks(self, method: RowAlignment) -> tuple[Reason, ...]:
        """Describe the alignment."""
        rows, (first, last) = self.shifts.rows, self.usable
        resampled = int((rows != np.rint(rows)).sum())
        message = PreparingMessage.ROWS_ALIGNED_WHOLE if self.shifts.whole else PreparingMessage.ROWS_ALIGNED
        aligned = message(
            method=method.value,
            first=first,
            last=last,
            rows=self.present.shape[1],
            complete=int(self.present[:, first:last].all(axis=0).sum()),
            moved=int((rows != 0.0).sum()),
            views=rows.size,
            least=float(rows.min()),
            most=float(rows.max()),
            deviation=float(np.median(self.shifts.standard_deviation)),
        )
        return (aligned, PreparingMessage.VIEWS_RESAMPLED(views=resampled)) if resampled else (aligned,)


@dataclass(frozen=True, eq=False)
class Views:
    """Views (rows, cells) of a dataset, about `at_a_time` read together; `done` takes the number of samples."""

    data: h5py.Dataset
    present: Rows
    at_a_time: int
    done: Callable[[int], None]

    def images(self, made: Callable[[Stack], None]) -> Iterator[Stack]:
        """Yield each view after `made` has changed its block (views, rows, cells) in place."""
        for block, _ in self.blocks():
            made(block)
            for image in block:
                yield image.copy()  # a view that is kept does not keep its block
            del block, image  # before the next block is read

    def blocks(self) -> Iterator[tuple[Stack, int]]:
        """Yield blocks (views, rows, cells), each with the number of the first view."""
        chunk = self.data.chunks[0]
        step = max(1, self.at_a_time // chunk) * chunk
        for first in range(0, len(self.data), step):
            stop = min(first + step, len(self.data))
            yield self.data[first:stop], first
            self.done((stop - first) * math.prod(self.data.shape[1:]))

    def move(self, shifts: RowShifts) -> Rows:
        """Move each view along the log, in the file, and return which rows (views, rows) exist afterwards."""
        moved = self.present.copy()
        for block, first in self.blocks():
            for view, image in enumerate(block, start=first):
                if shifts.rows[view] != 0.0:
                    image[...] = shifted(image, self.present[view], shifts.rows[view], shifts.ends)
                    moved[view] = present_rows(image)
            self.data[first : first + len(block)] = block
            del block, image  # before the next block is read
        return moved


def align_rows(
    views: Views,
    angles_rad: FloatArray,
    method: RowAlignment,
    *,
    estimate: Callable[[Stack], None],
    prepare: Callable[[], None] | None,
) -> AlignedRows:
    """Align the views of an unprepared scan, and prepare it once the detector row of each sample is known.

    Where rows were lost on their way from the detector, each sample is moved back to its detector row first, because
    flat fields, dead cells and air belong to detector rows. Where the log moved, or nothing is moved, the rows of the
    file are the rows of the detector. `estimate` converts samples (views, rows, cells) in place to find the shifts.
    """
    shifts: RowShifts | None = None
    if not views.present.all():
        shifts = _shifts(views, angles_rad, method, estimate)
        if shifts.rows.any() and shifts.lost(views.present):
            present = views.move(shifts)
            if prepare is not None:
                prepare()
            return _aligned(shifts, present, angles_rad, mixed=False)
    if prepare is not None:
        prepare()
    if shifts is None or prepare is not None:
        shifts = _shifts(views, angles_rad, method, lambda _: None)  # line integrals are not changed
    moves = bool(shifts.rows.any())
    return _aligned(shifts, views.move(shifts) if moves else views.present, angles_rad, mixed=moves)


def _aligned(shifts: RowShifts, present: Rows, angles_rad: FloatArray, *, mixed: bool) -> AlignedRows:
    usable = usable_rows(present, angles_rad)
    if usable is None:
        raise RowsError("no row of the log is in half of the views: leave out the views that lost most rows")
    return AlignedRows(shifts, present, usable, mixed)


def _shifts(views: Views, angles_rad: FloatArray, method: RowAlignment, estimate: Callable[[Stack], None]) -> RowShifts:
    images = views.images(estimate)
    if method is RowAlignment.PROFILE:
        return shifts_by_mass(RowMoments.of(images, _object_cells(views, estimate)), angles_rad)
    # scikit-image takes half a second to import, and few scans need it.
    from sawmill_tomography.preparing.shifts_by_features import shifts_by_features  # noqa: PLC0415

    return shifts_by_features(images, angles_rad)


def _object_cells(views: Views, estimate: Callable[[Stack], None]) -> NDArray[np.bool_]:
    """Return the cells (cells,) that are not air in some rows along the log; all cells if there is no air."""
    rows = np.unique(np.linspace(0, views.data.shape[1] - 1, AIR_ROWS).round().astype(int))
    shown = np.zeros(views.data.shape[2], bool)
    for row in rows.tolist():
        sinogram = views.data[:, row : row + 1][views.present[:, row]]
        if len(sinogram):
            estimate(sinogram)
            air = find_air(sinogram[:, 0])
            shown |= True if air is None else ~air.cells
    return shown if shown.any() else ~shown
