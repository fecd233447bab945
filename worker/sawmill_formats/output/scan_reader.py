"""Reading of the scans of `scan_writer`: some rows and views, or one sinogram."""

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import errors
from sawmill_formats.detector_modules import (
    MOST_MODULES,
    OFFSET,
    ORIGIN,
    SIZE,
    STEP,
    ModulesUnusable,
    PlacedModule,
    modules_after_first,
    translation,
)
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.output import scan_layout
from sawmill_formats.output.own_hdf5 import (
    CHECKED,
    check_chunk,
    check_chunks,
    check_members,
    dataset_at,
    group_at,
    needed,
    reading_own,
    values_at,
    values_of,
)
from sawmill_vocabulary import DetectorModule

Shape = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class OpenScan:
    """An open file of `new_scan`: its values, and its rows as they are needed."""

    shape: tuple[int, int, int]  # (views, rows, detector): shape of the whole scan
    angles_rad: NDArray[np.float64]  # (views,)
    detector_pitch_mm: float
    row_pitch_mm: float | None
    data: h5py.Dataset  # the line integrals, and the air level of counts
    air_level: h5py.Dataset | None
    # (views, rows) bool, or None: rows that each view has, where views lack rows; missing rows are NaN in the data
    present: NDArray[np.bool_] | None = None
    # (first, one after the last) or None: rows that enough views have, where views lack rows
    usable_rows: tuple[int, int] | None = None
    # Standard deviations of the line integrals, where the scan came with them or rays were masked; 0: not known
    deviations: h5py.Dataset | None = None
    # Modules of the detector after the first, where the scan came with them
    detector_modules: tuple[DetectorModule, ...] = ()
    detector_arc_radius_mm: float | None = None  # radius of the arc on which the cells lie, where the file stated one
    views_left_out: tuple[int, ...] = ()  # numbers of the views that are corrupt
    saturated_share: float = 0.0  # share of the cells that are saturated; 0 where it is not known

    def rows(self, selected: slice | range, views: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Read line integrals (views, rows, detector) float32 of some rows, and of some views or all.

        Raises
        ------
        UnreadableScan
            The data are damaged.
        """
        return _read(self.data, selected, views)

    def deviations_of(
        self, selected: slice | range, views: NDArray[np.integer] | None = None
    ) -> NDArray[np.float32] | None:
        """Read standard deviations with the same selection as `rows`; None where they are not known."""
        return None if self.deviations is None else _read(self.deviations, selected, views)


def _read(dataset: h5py.Dataset, selected: slice | range, views: NDArray[np.integer] | None) -> NDArray[np.float32]:
    # Chunks span the views, or many of them: reading all views of a row and choosing afterwards costs little.
    with errors.library_errors_translated("HDF5"):
        stack: NDArray[np.float32] = dataset[:, slice(selected.start, selected.stop, selected.step), :]
    return stack if views is None or np.array_equal(views, np.arange(len(stack))) else stack[views]


def check_scan(path: Path, shape: Shape) -> None:
    """Check that scan.h5 holds the recorded scan, and nothing that leads elsewhere; no image is read.

    Parameters
    ----------
    shape : (views, rows, detector)
        Shape as it is recorded.

    Raises
    ------
    DamagedResult
        It does not.
    """
    with reading_own(path) as file:
        check_members(file, path, 2 * 4 * math.prod(shape))
        _opened(file, shape)


@contextmanager
def open_scan(path: Path) -> Iterator[OpenScan]:
    """Open a file that this product wrote; uploads go through `reading_scan`.

    Raises
    ------
    DamagedResult
        The file is damaged, or another one.
    """
    with ExitStack() as files:
        with errors.damage_reported(path.name):
            file = files.enter_context(open_hdf5(path))
            opened = _opened(file, needed(dataset_at(file, scan_layout.DATA, filters=CHECKED), scan_layout.DATA).shape)
            check_chunks(opened.data)
        yield opened


def _opened(file: h5py.File, shape: Shape) -> OpenScan:
    views, rows, detector = shape
    data = needed(dataset_at(file, scan_layout.DATA, shape, CHECKED), scan_layout.DATA)
    present, usable_rows = _rows_present(file, (views, rows))
    pitch_mm = float(values_of(file, scan_layout.CELL_PITCH, ()))
    row_pitch, arc_radius = (values_at(file, path, ()) for path in (scan_layout.ROW_PITCH, scan_layout.ARC_RADIUS))
    return OpenScan(
        shape=shape,
        angles_rad=np.deg2rad(values_of(file, scan_layout.ANGLES, (views,))),
        detector_pitch_mm=pitch_mm,
        row_pitch_mm=None if row_pitch is None else float(row_pitch),
        data=data,
        air_level=dataset_at(file, scan_layout.AIR_LEVEL, (rows, detector)),
        present=present,
        usable_rows=usable_rows,
        deviations=dataset_at(file, scan_layout.DEVIATIONS, shape),
        detector_modules=_modules(file, detector, pitch_mm),
        detector_arc_radius_mm=None if arc_radius is None else float(arc_radius),
        views_left_out=_views_left_out(file, views),
        saturated_share=float(values_at(file, scan_layout.SATURATED_SHARE, ()) or 0.0),
    )


def _views_left_out(file: h5py.File, views: int) -> tuple[int, ...]:
    numbers = values_at(file, scan_layout.VIEWS_LEFT_OUT)
    if numbers is None:
        return ()
    if numbers.dtype.kind not in "iu" or numbers.ndim != 1 or not ((numbers >= 0) & (numbers < views)).all():
        raise errors.NotAsWritten(f"its views that are left out are no numbers of its {views} views")
    return tuple(numbers.tolist())


def _modules(file: h5py.File, cells: int, pitch_mm: float) -> tuple[DetectorModule, ...]:
    placed: list[PlacedModule] = []
    try:
        while len(placed) < MOST_MODULES and group_at(file, where := scan_layout.MODULE % len(placed)) is not None:
            (_, first), (_, of_module) = (values_of(file, f"{where}/{name}", (2,)).tolist() for name in (ORIGIN, SIZE))
            start_mm, step_mm = (_translation(file, f"{where}/{name}") for name in (OFFSET, STEP))
            placed.append(PlacedModule(first, of_module, start_mm, step_mm))
        return modules_after_first(placed, cells, pitch_mm) if placed else ()
    except ModulesUnusable as error:
        raise errors.NotAsWritten(f"its modules cannot be used: {error}") from error


def _translation(file: h5py.File, path: str) -> NDArray[np.float64]:
    dataset = needed(dataset_at(file, path, ()), path)
    return translation(float(dataset[()]), dataset.attrs["vector"], path)


def _rows_present(
    file: h5py.File, shape: tuple[int, int]
) -> tuple[NDArray[np.bool_], tuple[int, int]] | tuple[None, None]:
    present = dataset_at(file, scan_layout.ROWS_PRESENT, shape)
    if present is None:
        return None, None
    first, last = (int(row) for row in present.attrs[scan_layout.USABLE])
    if not 0 <= first < last <= shape[1]:
        raise errors.NotAsWritten(f"its usable rows are {first}:{last} of {shape[1]}")
    return present[()].astype(bool), (first, last)


@dataclass(frozen=True)
class Sinogram:
    """A detector row of a scan."""

    data: NDArray[np.float32]  # (views, detector) float32: line integrals, dimensionless
    angles_deg: NDArray[np.float64]  # (views,): each view's angle
    pitch_mm: float  # distance between detector cells


def sinogram(path: Path, shape: Shape, row: int) -> Sinogram:
    """Read one detector row of scan.h5, of the views that have it.

    Parameters
    ----------
    shape : (views, rows, detector)
        Shape as it is recorded.

    Raises
    ------
    OutOfRange
        The scan has no such row, or no view of it has.
    DamagedResult
        The file is damaged, or another one.
    """
    views, rows, _ = shape
    errors.check_index("row", row, rows)
    with reading_own(path) as file:
        scan = needed(dataset_at(file, scan_layout.DATA, shape, CHECKED), scan_layout.DATA)
        for first in range(0, views, scan.chunks[0]):
            check_chunk(scan, (first, row, 0))
        data, angles_deg = scan[:, row, :], values_of(file, scan_layout.ANGLES, (views,)).astype(np.float64)
        there = np.ones(views, bool)
        present = values_at(file, scan_layout.ROWS_PRESENT, (views, rows))
        if present is not None:
            there = present[:, row].astype(bool)
            if not there.any():
                raise errors.OutOfRange("row-out-of-range", f"no view has row {row}: the views that show it lost it")
        there[list(_views_left_out(file, views))] = False
        return Sinogram(
            data=data[there], angles_deg=angles_deg[there], pitch_mm=float(values_of(file, scan_layout.CELL_PITCH, ()))
        )
