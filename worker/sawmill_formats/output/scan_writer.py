"""Writing of scans: line integrals as the product stores them, and detector counts as a scanner would."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nxtomo
from sawmill_formats.detector_modules import ACROSS, CLASS, OFFSET, ORIGIN, SIZE, STEP, PlacedModule, placed_modules
from sawmill_formats.hdf5 import whole_hdf5
from sawmill_formats.nexus import CHUNK_BYTES, PACKED, new_entry, new_group, write_mapping, write_scalar
from sawmill_formats.output import scan_layout
from sawmill_vocabulary import DetectorModule


@dataclass(frozen=True, eq=False)
class RowsPresent:
    """Rows that views have, where views lack some."""

    of_views: NDArray[np.bool_]  # (views, rows) bool: True where a view has the row; missing rows are NaN in the data
    usable: tuple[int, int]  # (first, one after the last): the rows that enough views have


@dataclass(frozen=True, eq=False)
class NewScan:
    """A scan's file that is being written."""

    data: h5py.Dataset  # dataset (views, rows, detector) float32: the line integrals, to be written and read in blocks

    def note(
        self,
        *,
        air_level: NDArray[np.float32] | None,
        provenance: Mapping[str, str],
        row_shifts: NDArray[np.float64] | None = None,
        row_shift_deviations: NDArray[np.float64] | None = None,
        rows_present: RowsPresent | None = None,
        deviations: NDArray[np.float32] | None = None,
        views_left_out: Sequence[int] = (),
        saturated_share: float | None = None,
    ) -> None:
        """Write properties that are known when all line integrals are there.

        `row_shift_deviations` (views,), rows, or None: the standard deviation of each shift. `deviations` (views,
        detector) float32, or None: standard deviations of the line integrals of the one row; None where they are not
        known.
        """
        if views_left_out:
            self.data.file[scan_layout.VIEWS_LEFT_OUT] = np.array(views_left_out, np.int32)
        if rows_present is not None:
            self.data.file[scan_layout.ROWS_PRESENT] = rows_present.of_views.astype(np.uint8)
            self.data.file[scan_layout.ROWS_PRESENT].attrs[scan_layout.USABLE] = rows_present.usable
        if deviations is not None:
            write_scalar(self.data.file, scan_layout.DEVIATIONS, deviations[:, np.newaxis], "1")
        if air_level is not None:
            write_scalar(self.data.file, scan_layout.AIR_LEVEL, air_level.astype(np.float32), "counts")
        if saturated_share is not None:
            write_scalar(self.data.file, scan_layout.SATURATED_SHARE, saturated_share, "1")
        group = new_group(self.data.file, scan_layout.PROVENANCE, "NXcollection")
        for name, text in provenance.items():
            group[name] = text
        if row_shifts is not None:
            write_scalar(group, scan_layout.ROW_SHIFTS, row_shifts, "row")
        if row_shift_deviations is not None:
            write_scalar(group, scan_layout.ROW_SHIFT_DEVIATIONS, row_shift_deviations, "row")


@contextmanager
def new_scan(
    path: Path,
    shape: tuple[int, int, int],
    *,
    angles_rad: NDArray[np.float64],
    detector_pitch_mm: float,
    row_pitch_mm: float | None,
    detector_modules: Sequence[DetectorModule] = (),
    detector_arc_radius_mm: float | None = None,
    views_together: int | None = None,
) -> Iterator[NewScan]:
    """Open a new scan (views, rows, detector) of line integrals, readable row by row; whole or not at all.

    Parameters
    ----------
    detector_modules : sequence of DetectorModule, optional
        Modules of the detector after the first.
    detector_arc_radius_mm : float, optional
        Radius of the arc on which the cells lie.
    views_together : int, optional
        The number of views of a row that are stored in one piece: all, by default.

    Raises
    ------
    ValueError
        When the shapes do not agree.
    OSError
        When the file cannot be written.
    """
    _check_stack("the scan", shape, angles_rad)
    views, rows, detector = shape
    within_chunk = max(1, CHUNK_BYTES // (4 * detector))
    with whole_hdf5(path) as file:
        _new_images(
            file,
            shape,
            np.dtype(np.float32),
            chunks=(min(views_together or views, views, within_chunk), 1, detector),
            units="1",
            image_key=np.zeros(views, dtype=np.uint8),
            angles_deg=_degrees(angles_rad),
            lengths_mm=(detector_pitch_mm, row_pitch_mm, detector_arc_radius_mm),
            # Packing the noise of line integrals saves a fifth of the disk, and takes longer than reconstructing them.
            storage={"fletcher32": True},
        )
        file[scan_layout.DATA].attrs["long_name"] = scan_layout.LINE_INTEGRALS
        if detector_modules:
            _write_modules(file, placed_modules(detector_modules, detector, detector_pitch_mm), rows)
        yield NewScan(file[scan_layout.DATA])


def write_raw_scan(
    path: Path,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    *,
    counts: Iterable[NDArray[Any]],
    flats: NDArray[Any] | None,
    darks: NDArray[Any] | None,
    angles_rad: NDArray[np.float64],
    detector_pitch_mm: float | None,
    row_pitch_mm: float | None,
    detector_modules: Sequence[DetectorModule] = (),
    detector_arc_radius_mm: float | None = None,
    given: Mapping[str, Any] | None = None,
) -> None:
    """Write detector counts as a scanner would: dark fields, flat fields, then the views; or views without fields.

    Parameters
    ----------
    shape, dtype
        Shape (views, rows, detector) and type of the counts, uint16 or float32.
    counts : iterable of (n, rows, detector)
        The counts, some views at a time.
    flats, darks : (n, rows, detector), of the same type, or None
    angles_rad : (views,) float64
    detector_pitch_mm, row_pitch_mm : float, or None where it is not known
    detector_modules, detector_arc_radius_mm, given : optional
        Modules after the first; radius of the arc of cells; what the owner of a packed scan gave, by names: its file
        holds no time of writing.

    Raises
    ------
    ValueError
        When the shapes do not agree.
    OSError
        When the file cannot be written.
    """
    _check_stack("counts", shape, angles_rad)
    fields = [(key, images) for key, images in ((nxtomo.DARK, darks), (nxtomo.FLAT, flats)) if images is not None]
    keys = [key for key, images in fields for _ in images]
    with whole_hdf5(path) as file:
        _new_images(
            file,
            (len(keys) + shape[0], *shape[1:]),
            dtype,
            chunks=(1, *shape[1:]),
            units="counts" if fields else "1",
            image_key=np.array(keys + [nxtomo.PROJECTION] * shape[0], dtype=np.uint8),
            angles_deg=np.concatenate([np.zeros(len(keys)), _degrees(angles_rad)]),
            lengths_mm=(detector_pitch_mm, row_pitch_mm, detector_arc_radius_mm),
            storage=PACKED,
            given=given,
        )
        if detector_modules and detector_pitch_mm is not None:
            _write_modules(file, placed_modules(detector_modules, shape[2], detector_pitch_mm), shape[1])
        data, first = file[scan_layout.DATA], 0
        for images in chain((images for _, images in fields), counts):
            data[first : first + len(images)] = images
            first += len(images)


def _degrees(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the degrees that are read back as these angles to the last digit, where there are such degrees."""
    degrees = np.rad2deg(angles_rad)
    near = [np.nextafter(degrees, towards) for towards in (degrees, -np.inf, np.inf)]
    return np.select([np.deg2rad(each) == angles_rad for each in near], near, degrees)


def _write_modules(file: h5py.File, modules: Sequence[PlacedModule], rows: int) -> None:
    for number, module in enumerate(modules):
        group = new_group(file, scan_layout.MODULE % number, CLASS)
        group[ORIGIN], group[SIZE] = [0, module.first], [rows, module.cells]
        for name, translation in ((OFFSET, module.start_mm), (STEP, module.step_mm)):
            length = float(np.linalg.norm(translation))
            write_scalar(group, name, length, "mm")
            attributes = group[name].attrs
            attributes["vector"] = translation / length if length else ACROSS
            attributes["transformation_type"], attributes["depends_on"] = "translation", "."


def _check_stack(name: str, shape: tuple[int, ...], angles_rad: NDArray[np.float64]) -> None:
    if len(shape) != 3 or angles_rad.shape != shape[:1]:
        raise ValueError(
            f"{name} must be (views, rows, detector) with one angle for each view, not of shape {shape} "
            f"with {angles_rad.shape} angles"
        )


def _new_images(
    file: h5py.File,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    *,
    chunks: tuple[int, ...],
    units: str,
    image_key: NDArray[np.uint8],
    angles_deg: NDArray[np.float64],
    lengths_mm: tuple[float | None, float | None, float | None],
    storage: Mapping[str, Any],
    given: Mapping[str, Any] | None = None,
) -> None:
    entry = new_entry(file, nxtomo.DEFINITION, timed=given is None)
    if given is not None:
        write_mapping(entry, nxtomo.GIVEN, given)
    new_group(entry, "instrument", "NXinstrument")
    new_group(entry, nxtomo.DETECTOR, "NXdetector")
    entry.create_dataset(nxtomo.DATA, shape, dtype, chunks=chunks, **storage).attrs["units"] = units
    entry[nxtomo.IMAGE_KEY] = image_key
    for path, length_mm in zip((nxtomo.CELL_PITCH, nxtomo.ROW_PITCH, nxtomo.ARC_RADIUS), lengths_mm, strict=True):
        if length_mm is not None:
            write_scalar(entry, path, length_mm, "mm")
    new_group(entry, "sample", "NXsample")
    write_scalar(entry, nxtomo.ANGLES, angles_deg, "deg")
    links = new_group(entry, "data", "NXdata")
    links.attrs["signal"] = "data"
    for path in (nxtomo.DATA, nxtomo.IMAGE_KEY, nxtomo.ANGLES):
        links[path.rpartition("/")[2]] = entry[path]
