"""Recognition of our own files and their kind."""

from contextlib import suppress
from enum import StrEnum
from pathlib import Path

import h5py

from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.hdf5 import open_hdf5
from sawmill_formats.input.hdf5.guard import find
from sawmill_formats.input.hdf5.texts import read_text
from sawmill_formats.input.own.scan import is_own_scan
from sawmill_formats.output import volume_layout
from sawmill_formats.output.calibration_file import ANSWER


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
        if read_text(file, f"{volume_layout.ENTRY}/definition") == volume_layout.DEFINITION:
            return OwnKind.VOLUME
        if isinstance(find(file, ANSWER), h5py.Dataset):
            return OwnKind.CALIBRATION
    return None
