"""Scans as the product keeps and hands them out: HDF5 in the NXtomo layout."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_worker.formats.arrays import MAX_BYTES, Bounds
from sawmill_worker.formats.atomic import whole_hdf5
from sawmill_worker.formats.errors import UnreadableScan, library_errors_translated
from sawmill_worker.formats.hdf5_guard import attribute_text, find, numbers, open_hdf5, read_text
from sawmill_worker.formats.hdf5_nxtomo import DARK, FLAT, PROJECTION
from sawmill_worker.formats.nexus import CHUNK_BYTES, PACKED, new_entry, new_group, write_scalar

DETECTOR = "entry/instrument/detector"
ANGLES = "entry/sample/rotation_angle"
PROVENANCE = "provenance"
LINE_INTEGRALS = "line integrals"


@dataclass(frozen=True, eq=False)
class StoredScan:
    """A scan, or the rows and views of it that were asked for.

    Attributes
    ----------
    line_integrals : (views, rows, detector) float32, dimensionless
    angles_rad : (views,) float64
    air_level : (rows, detector) float32, counts, or None
        Mean flat less mean dark field; None where the scan was given as line integrals.
    detector_pitch_mm : float
    row_pitch_mm : float or None
    """

    line_integrals: NDArray[np.float32]
    angles_rad: NDArray[np.float64]
    air_level: NDArray[np.float32] | None
    detector_pitch_mm: float
    row_pitch_mm: float | None


@dataclass(frozen=True, eq=False)
class NewScan:
    """A scan's file that is being written.

    Attributes
    ----------
    data : dataset (views, rows, detector) float32
        The line integrals, to be written and read in blocks.
    """

    data: h5py.Dataset
    _entry: h5py.Group

    def keep_rows(self, rows: int) -> None:
        """Forget all rows but the first `rows`."""
        self.data.resize(rows, axis=1)

    def note(
        self,
        *,
        air_level: NDArray[np.float32] | None,
        provenance: Mapping[str, str],
        row_shifts: NDArray[np.float64] | None = None,
    ) -> None:
        """Say what is known when all line integrals are there; the parameters are those of `write_scan`."""
        if air_level is not None:
            write_scalar(self.data.parent, "air_level", air_level.astype(np.float32), "counts")
        group = new_group(self._entry, PROVENANCE, "NXcollection")
        for name, text in provenance.items():
            group[name] = text
        if row_shifts is not None:
            write_scalar(group, "row_shifts", row_shifts, "row")


@contextmanager
def new_scan(
    path: Path,
    shape: tuple[int, int, int],
    *,
    angles_rad: NDArray[np.float64],
    detector_pitch_mm: float,
    row_pitch_mm: float | None,
    views_together: int | None = None,
) -> Iterator[NewScan]:
    """A new scan (views, rows, detector) of line integrals, one row of which can be read alone; whole or not at all.

    Parameters
    ----------
    views_together : int, optional
        Of how many views a row is stored in one piece: all, by default.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    views, _, detector = shape
    within_chunk = max(1, CHUNK_BYTES // (4 * detector))
    with whole_hdf5(path) as file:
        entry = _new_frames(
            file,
            shape,
            np.dtype(np.float32),
            chunks=(min(views_together or views, views, within_chunk), 1, detector),
            units="1",
            image_key=np.zeros(views, dtype=np.uint8),
            angles_deg=np.rad2deg(angles_rad),
            pitches_mm=(detector_pitch_mm, row_pitch_mm),
            # Packing the noise of line integrals saves a fifth of the disk, and takes longer than reconstructing them.
            storage={"fletcher32": True},
        )
        data = file[f"{DETECTOR}/data"]
        data.attrs["long_name"] = LINE_INTEGRALS
        yield NewScan(data, entry)


def write_scan(
    path: Path,
    *,
    line_integrals: NDArray[np.float32],
    angles_rad: NDArray[np.float64],
    detector_pitch_mm: float,
    row_pitch_mm: float | None,
    air_level: NDArray[np.float32] | None,
    provenance: Mapping[str, str],
    row_shifts: NDArray[np.float64] | None = None,
) -> None:
    """Write a scan of line integrals that are in memory.

    Parameters
    ----------
    line_integrals : (views, rows, detector) float32, dimensionless
    angles_rad : (views,) float64
    detector_pitch_mm, row_pitch_mm : float
        Distances between cells and between rows.
    air_level : (rows, detector) float32, counts, or None
        Mean flat less mean dark field: with it counts can be recovered from line integrals.
    provenance : mapping of str to str
        Where the data come from, as the file is to say it.
    row_shifts : (views,) float64, rows, or None
        By how much each view was moved along the log; None where none was.

    Raises
    ------
    ValueError
        When the shapes do not agree.
    OSError
        When the file cannot be written.
    """
    _check_stack("line_integrals", line_integrals, angles_rad)
    views, rows, detector = line_integrals.shape
    scan = new_scan(
        path,
        (views, rows, detector),
        angles_rad=angles_rad,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
    )
    with scan as written:
        written.data[...] = line_integrals
        written.note(air_level=air_level, provenance=provenance, row_shifts=row_shifts)


@dataclass(frozen=True, eq=False)
class OpenScan:
    """A file of `new_scan` held open: what it says, and its rows as they are needed.

    Attributes
    ----------
    shape : (views, rows, detector)
        Of the whole scan.
    angles_rad : (views,) float64
    detector_pitch_mm : float
    row_pitch_mm : float or None
    data, air_level : dataset
        The line integrals, and the air level of counts.
    """

    shape: tuple[int, int, int]
    angles_rad: NDArray[np.float64]
    detector_pitch_mm: float
    row_pitch_mm: float | None
    data: h5py.Dataset
    air_level: h5py.Dataset | None

    def rows(self, wanted: slice | range, views: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Line integrals (views, rows, detector) float32 of some rows, and of some views or all.

        Raises
        ------
        UnreadableScan
            Where they are damaged.
        """
        # Chunks span the views, or many of them: reading all of a row's views and choosing afterwards costs little.
        with library_errors_translated("HDF5"):
            stack: NDArray[np.float32] = self.data[:, slice(wanted.start, wanted.stop, wanted.step), :]
        return stack if views is None or np.array_equal(views, np.arange(len(stack))) else stack[views]


@contextmanager
def open_scan(path: Path) -> Iterator[OpenScan]:
    """Open a file that this product wrote; uploads go through `reading_scan`."""
    with open_hdf5(path) as file:
        detector = file[DETECTOR]
        yield OpenScan(
            shape=detector["data"].shape,
            angles_rad=np.deg2rad(file[ANGLES][()]),
            detector_pitch_mm=float(detector["x_pixel_size"][()]),
            row_pitch_mm=float(detector["y_pixel_size"][()]) if "y_pixel_size" in detector else None,
            data=detector["data"],
            air_level=detector.get("air_level"),
        )


def is_own_scan(path: Path) -> bool:
    """Whether a file of any kind is one of `new_scan`, whole and with all of its data in it.

    One that only looks so is none: `reading_scan` says what is wrong with it.
    """
    if not h5py.is_hdf5(path):
        return False
    with suppress(UnreadableScan), library_errors_translated("HDF5"), open_hdf5(path) as file:
        return _is_marked(file) and _is_whole(file)
    return False


def _is_marked(file: h5py.File) -> bool:
    data = find(file, f"{DETECTOR}/data")
    own = read_text(file, "entry/definition") == "NXtomo" and find(file, f"entry/{PROVENANCE}") is not None
    return own and data is not None and attribute_text(data, "long_name") == LINE_INTEGRALS


def _is_whole(file: h5py.File) -> bool:
    bounds = Bounds(MAX_BYTES, CHUNK_BYTES)
    data = numbers(file, f"{DETECTOR}/data", bounds)
    angles = numbers(file, ANGLES, bounds.whole)
    x_pitch, y_pitch, air_level = (
        numbers(file, f"{DETECTOR}/{name}", bounds) for name in ("x_pixel_size", "y_pixel_size", "air_level")
    )
    if data is None or angles is None or x_pitch is None or data.dtype != np.float32 or data.ndim != 3:
        return False
    if not data.size or angles.shape != data.shape[:1] or not np.isfinite(angles[()]).all():
        return False
    pitches_are_numbers = x_pitch.shape == () and (y_pitch is None or y_pitch.shape == ())
    return pitches_are_numbers and (air_level is None or air_level.shape == data.shape[1:])


def read_stored_scan(path: Path, rows: slice | None = None, views: NDArray[np.integer] | None = None) -> StoredScan:
    """Read a file of `new_scan`, or part of it.

    Parameters
    ----------
    path : Path
        A file that this product wrote; uploads go through `reading_scan`.
    rows : slice, optional
        Detector rows, with step 1; all by default.
    views : (n,) integers, optional
        Views in the order wanted; all by default.
    """
    wanted = rows or slice(None)
    with open_scan(path) as scan:
        return StoredScan(
            line_integrals=scan.rows(wanted, views),
            angles_rad=scan.angles_rad if views is None else scan.angles_rad[views],
            air_level=None if scan.air_level is None else scan.air_level[wanted, :],
            detector_pitch_mm=scan.detector_pitch_mm,
            row_pitch_mm=scan.row_pitch_mm,
        )


def write_raw_scan(
    path: Path,
    *,
    counts: NDArray[np.uint16] | NDArray[np.float32],
    flats: NDArray[np.uint16] | NDArray[np.float32],
    darks: NDArray[np.uint16] | NDArray[np.float32],
    angles_rad: NDArray[np.float64],
    detector_pitch_mm: float,
    row_pitch_mm: float | None,
) -> None:
    """Write detector counts as a scanner would: dark fields, flat fields, then the views.

    Parameters
    ----------
    counts : (views, rows, detector) uint16 or float32
    flats, darks : (n, rows, detector), of the same type
    angles_rad : (views,) float64
    detector_pitch_mm, row_pitch_mm : float

    Raises
    ------
    ValueError
        When the shapes do not agree.
    OSError
        When the file cannot be written.
    """
    _check_stack("counts", counts, angles_rad)
    fields = len(darks) + len(flats)
    keys = [DARK] * len(darks) + [FLAT] * len(flats) + [PROJECTION] * len(counts)
    with whole_hdf5(path) as file:
        _new_frames(
            file,
            (len(keys), *counts.shape[1:]),
            counts.dtype,
            chunks=(1, *counts.shape[1:]),
            units="counts",
            image_key=np.array(keys, dtype=np.uint8),
            angles_deg=np.concatenate([np.zeros(fields), np.rad2deg(angles_rad)]),
            pitches_mm=(detector_pitch_mm, row_pitch_mm),
            storage=PACKED,
        )
        data, first = file[f"{DETECTOR}/data"], 0
        for frames in (darks, flats, counts):
            data[first : first + len(frames)] = frames
            first += len(frames)


def _check_stack(name: str, stack: NDArray[np.uint16] | NDArray[np.float32], angles_rad: NDArray[np.float64]) -> None:
    if stack.ndim != 3 or angles_rad.shape != (len(stack),):
        raise ValueError(
            f"{name} must be (views, rows, detector) with one angle for each view, not of shape {stack.shape} "
            f"with {angles_rad.shape} angles"
        )


def _new_frames(
    file: h5py.File,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    *,
    chunks: tuple[int, int, int],
    units: str,
    image_key: NDArray[np.uint8],
    angles_deg: NDArray[np.float64],
    pitches_mm: tuple[float, float | None],
    storage: Mapping[str, Any],
) -> h5py.Group:
    entry = new_entry(file, "NXtomo")
    detector = new_group(new_group(entry, "instrument", "NXinstrument"), "detector", "NXdetector")
    detector.create_dataset("data", shape, dtype, chunks=chunks, **storage).attrs["units"] = units
    detector["image_key"] = image_key
    for name, pitch_mm in zip(("x_pixel_size", "y_pixel_size"), pitches_mm, strict=True):
        if pitch_mm is not None:
            write_scalar(detector, name, pitch_mm, "mm")
    sample = new_group(entry, "sample", "NXsample")
    write_scalar(sample, "rotation_angle", angles_deg, "deg")
    links = new_group(entry, "data", "NXdata")
    links.attrs["signal"] = "data"
    links["data"], links["image_key"] = detector["data"], detector["image_key"]
    links["rotation_angle"] = sample["rotation_angle"]
    return entry
