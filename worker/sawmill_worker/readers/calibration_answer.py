"""A calibration's answer in an HDF5 file that somebody names as a calibration's."""

from pathlib import Path

from sawmill_worker.files.calibration_file import ANSWER
from sawmill_worker.files.errors import UnreadableScan, library_errors_translated
from sawmill_worker.files.hdf5 import open_hdf5
from sawmill_worker.readers.hdf5_texts import read_text

# The most bytes that are read of an answer: it has some ten thousand.
LONGEST_ANSWER = 16 * 2**20


def read_calibration_json(path: Path) -> str:
    """The answer as JSON text, from a file that `files.calibration_file` wrote, or that is named as one.

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
