"""Reading back the scans of `scan_writer`: whole, some rows and views, or one sinogram."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.errors import OutOfRange, check_index, library_errors_translated
from sawmill_worker.files.hdf5 import open_hdf5
from sawmill_worker.files.scan_layout import (
    AIR_LEVEL,
    ANGLES,
    CELL_PITCH,
    DATA,
    DEVIATIONS,
    ROW_PITCH,
    ROWS_PRESENT,
    USABLE,
)


@dataclass(frozen=True, eq=False)
class StoredScan:
    """A scan, or the rows and views of it that were asked for.

    Attributes
    ----------
    line_integrals : (views, rows, detector) float32, dimensionless
        NaN in every cell of the rows that a view lacks.
    angles_rad : (views,) float64
    air_level : (rows, detector) float32, counts, or None
        Mean flat less mean dark field; None where the scan was given as line integrals.
    detector_pitch_mm : float
    row_pitch_mm : float or None
    deviations : (views, rows, detector) float32, or None
        Standard deviations of the line integrals, where they came with them or rays were masked; 0 is not known.
    """

    line_integrals: NDArray[np.float32]
    angles_rad: NDArray[np.float64]
    air_level: NDArray[np.float32] | None
    detector_pitch_mm: float
    row_pitch_mm: float | None
    deviations: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class OpenScan:
    """A file of `new_scan` held open: its values, and its rows as they are needed.

    Attributes
    ----------
    shape : (views, rows, detector)
        Of the whole scan.
    angles_rad : (views,) float64
    detector_pitch_mm : float
    row_pitch_mm : float or None
    data, air_level : dataset
        The line integrals, and the air level of counts.
    present : (views, rows) bool, or None
        Which rows each view has, where some lack some: those are NaN in the data.
    usable_rows : (first, one after the last) or None
        The rows that enough views have, where some lack some.
    deviations : dataset or None
        The standard deviations of the line integrals, where they came with them or rays were masked; 0 is not known.
    """

    shape: tuple[int, int, int]
    angles_rad: NDArray[np.float64]
    detector_pitch_mm: float
    row_pitch_mm: float | None
    data: h5py.Dataset
    air_level: h5py.Dataset | None
    present: NDArray[np.bool_] | None = None
    usable_rows: tuple[int, int] | None = None
    deviations: h5py.Dataset | None = None

    def rows(self, selected: slice | range, views: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Line integrals (views, rows, detector) float32 of some rows, and of some views or all.

        Raises
        ------
        UnreadableScan
            Where they are damaged.
        """
        return _read(self.data, selected, views)

    def deviations_of(
        self, selected: slice | range, views: NDArray[np.integer] | None = None
    ) -> NDArray[np.float32] | None:
        """Standard deviations, as `rows` gives what they are of; None where they are not known."""
        return None if self.deviations is None else _read(self.deviations, selected, views)


def _read(dataset: h5py.Dataset, selected: slice | range, views: NDArray[np.integer] | None) -> NDArray[np.float32]:
    # Chunks span the views, or many of them: reading all of a row's views and choosing afterwards costs little.
    with library_errors_translated("HDF5"):
        stack: NDArray[np.float32] = dataset[:, slice(selected.start, selected.stop, selected.step), :]
    return stack if views is None or np.array_equal(views, np.arange(len(stack))) else stack[views]


@contextmanager
def open_scan(path: Path) -> Iterator[OpenScan]:
    """Open a file that this product wrote; uploads go through `reading_scan`."""
    with open_hdf5(path) as file:
        present, usable_rows = _rows_present(file)
        yield OpenScan(
            shape=file[DATA].shape,
            angles_rad=np.deg2rad(file[ANGLES][()]),
            detector_pitch_mm=float(file[CELL_PITCH][()]),
            row_pitch_mm=float(file[ROW_PITCH][()]) if ROW_PITCH in file else None,
            data=file[DATA],
            air_level=file.get(AIR_LEVEL),
            present=present,
            usable_rows=usable_rows,
            deviations=file.get(DEVIATIONS),
        )


def _rows_present(file: h5py.File) -> tuple[NDArray[np.bool_], tuple[int, int]] | tuple[None, None]:
    if ROWS_PRESENT not in file:
        return None, None
    present = file[ROWS_PRESENT]
    first, last = (int(row) for row in present.attrs[USABLE])
    return present[()].astype(bool), (first, last)


def read_stored_scan(path: Path, rows: slice | None = None, views: NDArray[np.integer] | None = None) -> StoredScan:
    """Read a file of `new_scan`, or part of it.

    Parameters
    ----------
    path : Path
        A file that this product wrote; uploads go through `reading_scan`.
    rows : slice, optional
        Detector rows, with step 1; all by default.
    views : (n,) integers, optional
        Views in the order given; all by default.
    """
    selected = rows or slice(None)
    with open_scan(path) as scan:
        return StoredScan(
            line_integrals=scan.rows(selected, views),
            angles_rad=scan.angles_rad if views is None else scan.angles_rad[views],
            air_level=None if scan.air_level is None else scan.air_level[selected, :],
            detector_pitch_mm=scan.detector_pitch_mm,
            row_pitch_mm=scan.row_pitch_mm,
            deviations=scan.deviations_of(selected, views),
        )


@dataclass(frozen=True)
class Sinogram:
    """One detector row of a scan.

    Attributes
    ----------
    data : (views, detector) float32
        Line integrals, dimensionless.
    angles_deg : (views,) float64
        Each view's angle.
    pitch_mm
        Distance between detector cells.
    """

    data: NDArray[np.float32]
    angles_deg: NDArray[np.float64]
    pitch_mm: float


def sinogram(path: Path, row: int) -> Sinogram:
    """Read one detector row of scan.h5, of the views that have it.

    Raises
    ------
    OutOfRange
        The scan has no such row, or no view of it has.
    """
    with open_hdf5(path) as file:
        check_index("row", row, file[DATA].shape[1])
        data, angles_deg = file[DATA][:, row, :], file[ANGLES][:].astype(np.float64)
        if ROWS_PRESENT in file:
            there = file[ROWS_PRESENT][:, row].astype(bool)
            if not there.any():
                raise OutOfRange("row-out-of-range", f"no view has row {row}: the views that show it lost it")
            data, angles_deg = data[there], angles_deg[there]
        return Sinogram(data=data, angles_deg=angles_deg, pitch_mm=float(file[CELL_PITCH][()]))
