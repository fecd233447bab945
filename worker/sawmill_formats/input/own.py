"""Recognition of our own files; scans and calibrations among them are read as they are."""

from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nexus, nxtomo
from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.arrays import MAX_BYTES, Bounds
from sawmill_formats.input.contents import LARGEST_PITCH_MM, LEAST_PITCH_MM
from sawmill_formats.input.hdf5.guard import attribute_text, find, numbers, read_text, read_values
from sawmill_formats.input.plausible import LARGEST_ANGLE_DEG
from sawmill_formats.nexus import CHUNK_BYTES
from sawmill_formats.output import scan_layout
from sawmill_formats.output.calibration_file import ANSWER, ARRAYS
from sawmill_formats.output.scan_reader import open_scan


def is_own_scan(path: Path) -> bool:
    """Return whether a file is a whole scan of `sawmill_formats.output.scan_writer.new_scan`, with all data in it.

    A damaged file is not: `reading_scan` reports what is wrong with it.
    """
    if not h5py.is_hdf5(path):
        return False
    with suppress(UnreadableScan), library_errors_translated("HDF5"):
        with open_hdf5(path) as file:
            own = _is_marked(file) and numbers(file, scan_layout.DATA, Bounds(MAX_BYTES, CHUNK_BYTES)) is not None
        if own:
            with open_scan(path) as scan:  # a scan that was repacked is read as any other file
                single = all(each is None or each.dtype == np.float32 for each in (scan.data, scan.deviations))
                pitches_mm = (scan.detector_pitch_mm, scan.row_pitch_mm)
                distances = all(pitch is None or LEAST_PITCH_MM <= pitch <= LARGEST_PITCH_MM for pitch in pitches_mm)
                angles = bool((np.abs(np.rad2deg(scan.angles_rad)) <= LARGEST_ANGLE_DEG).all())
                return single and distances and angles and scan.data.size > 0
    return False


def _is_marked(file: h5py.File) -> bool:
    data = find(file, scan_layout.DATA)
    own = (
        read_text(file, f"{scan_layout.ENTRY}/definition") == nxtomo.DEFINITION
        and find(file, scan_layout.PROVENANCE) is not None
    )
    return own and data is not None and attribute_text(data, "long_name") == scan_layout.LINE_INTEGRALS


class OwnKind(StrEnum):
    """Kinds of files that this product writes."""

    SCAN = "scan"
    VOLUME = "volume"
    CALIBRATION = "calibration"


def own_kind(path: Path) -> OwnKind | None:
    """Recognise which of our own files this is, by its contents; None for any other, and for a damaged one."""
    if not h5py.is_hdf5(path):
        return None
    if is_own_scan(path):
        return OwnKind.SCAN
    with suppress(UnreadableScan), library_errors_translated("HDF5"), open_hdf5(path) as file:
        if read_text(file, f"{nexus.ENTRY}/definition") == nexus.DEFINITION:
            return OwnKind.VOLUME
        if isinstance(find(file, ANSWER), h5py.Dataset):
            return OwnKind.CALIBRATION
    return None


# Most bytes that are read of an answer, which has some ten thousand.
LONGEST_ANSWER = 16 * 2**20
# Bounds of each array, in memory at once: the sinogram of 10 000 views of 10 000 cells has 400 MB.
ARRAY = Bounds(2**29, 2**29)
NEEDED = (
    "sinogram",
    "model",
    "residual",
    "angles_rad",
    "phantom_image",
    "phantom_field_mm",
    "phantom_outlines_mm",
    "search_history",
)
OF_A_LOG = ("log_row", "log_field_mm", "log_after", "log_before")
TEXTS, WRITTEN_AT = ("phantom_image_method", "log_before_with"), "entry/start_time"


def read_calibration_json(path: Path, place: str = ANSWER) -> str:
    """Read the answer as JSON text from a file of `sawmill_formats.output.calibration_file`, or the text at a place.

    Raises
    ------
    UnreadableScan
        `dataset-missing` where the file is another one; it is damaged, or the text is too long.
    """
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        text = read_text(file, place, most_bytes=LONGEST_ANSWER)
    if text is None:
        raise UnreadableScan("dataset-missing", f"it is HDF5 without /{place}")
    return text


def read_calibration_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """Read the arrays behind an answer by name (docs/look-up/formats.md); None where it has the answer alone.

    Raises
    ------
    UnreadableScan
        `dataset-missing` where an array is missing; the file is damaged, or an array is too large.
    """
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        datasets = {name: numbers(file, f"{ARRAYS}/{name}", ARRAY) for name in (*NEEDED, *OF_A_LOG)}
        arrays = {name: read_values(dataset) for name, dataset in datasets.items() if dataset is not None}
        texts = {name: read_text(file, f"{ARRAYS}/{name}") for name in TEXTS}
    if not arrays:
        return None
    if missing := [name for name in NEEDED if name not in arrays]:
        raise UnreadableScan("dataset-missing", f"it has no /{ARRAYS}/{missing[0]}, which the pictures need")
    return arrays | {name: np.array(text.encode()) for name, text in texts.items() if text is not None}


def read_time_of_writing(path: Path) -> str | None:
    """Read when the file was written, RFC 3339; None where the file does not tell."""
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        return read_text(file, WRITTEN_AT)
