"""A calibration's answer and arrays in an HDF5 file that a client names as a calibration's."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.hdf5.guard import numbers, read_values
from sawmill_formats.input.hdf5.texts import read_text
from sawmill_formats.output.calibration_file import ANSWER, ARRAYS

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


def read_calibration_json(path: Path) -> str:
    """Read the answer as JSON text from a file of `sawmill_formats.output.calibration_file`, or one named as such.

    Raises
    ------
    UnreadableScan
        `dataset-missing` where the file is another one; it is damaged, or the text is too long.
    """
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        text = read_text(file, ANSWER, most_bytes=LONGEST_ANSWER)
    if text is None:
        raise UnreadableScan("dataset-missing", f"it is HDF5 without /{ANSWER}")
    return text


def read_calibration_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """Read the arrays behind an answer by name (docs/look-up/formats.md); None where it has the answer alone.

    Raises
    ------
    UnreadableScan
        `dataset-missing` where an array is missing; the file is damaged, or an array is too large.
    """
    with library_errors_translated("HDF5"), open_hdf5(path) as file:
        arrays = {name: values for name in (*NEEDED, *OF_A_LOG) if (values := _array(file, name)) is not None}
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


def _array(file: h5py.File, name: str) -> NDArray[Any] | None:
    dataset = numbers(file, f"{ARRAYS}/{name}", ARRAY)
    return None if dataset is None else read_values(dataset)
