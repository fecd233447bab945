"""The one way in: any file, with what its uploader gave beside it, to a canonical scan."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_worker.files.errors import UnreadableScan, library_errors_translated
from sawmill_worker.readers.angles import AnglesGiven
from sawmill_worker.readers.arrays import MAX_BYTES, Bounds, as_fields
from sawmill_worker.readers.canonical import CanonicalScan
from sawmill_worker.readers.contents import FileContents, Projections
from sawmill_worker.readers.hdf5 import read_hdf5
from sawmill_worker.readers.mat import read_mat5
from sawmill_worker.readers.npy import read_npy
from sawmill_worker.readers.tiff import read_tiff
from sawmill_worker.readers.zipped import read_zip

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512, 1024, 2048)  # a user block of such a size may stand before it, as in MATLAB files
ANGLE_TOLERANCE_DEG = 1e-6
SINGLE_PRECISION = 2.0**-23
PITCH_TOLERANCE = 1e-6
# Of the free memory, for what is read as a whole; the rest is for a block at a time, and the libraries.
MEMORY_SHARE = 0.9


@dataclass(frozen=True)
class _Format:
    name: str
    read: Callable[[Path, str | None, Bounds, ExitStack], FileContents]


_HDF5 = _Format("HDF5", read_hdf5)
_MAT = _Format("MAT", read_mat5)
_ZIP = _Format("ZIP", read_zip)
MAT_VERSIONS = (b"\x00\x01IM", b"\x01\x00MI")  # at byte 124, after a text of the writer's choice
_BY_FIRST_BYTES = (
    (b"\x93NUMPY", _Format("NPY", read_npy)),
    (b"PK\x03\x04", _ZIP),
    (b"PK\x05\x06", _ZIP),
    (b"II*\0", _Format("TIFF", read_tiff)),
    (b"MM\0*", _Format("TIFF", read_tiff)),
    (b"II+\0", _Format("TIFF", read_tiff)),
    (b"MM\0+", _Format("TIFF", read_tiff)),
)


@contextmanager
def reading_scan(
    path: Path,
    *,
    counts: bool,
    dataset: str | None = None,
    angles_deg: AnglesGiven | None = None,
    detector_pitch_mm: float | None = None,
    row_pitch_mm: float | None = None,
    rows_missing: bool = False,
    max_bytes: int = MAX_BYTES,
    free_bytes: int | None = None,
) -> Iterator[CanonicalScan]:
    """Open a scan's file of any supported format, recognised by its content and never by its name.

    The file stays open meanwhile: its projections are read by `CanonicalScan.blocks`.

    Parameters
    ----------
    path : Path
        The file, as it was uploaded.
    counts : bool
        Whether the data are detector counts; else they are line integrals. This is never guessed.
    dataset : str, optional
        Path or name of the projections, where the file holds several candidates.
    angles_deg : AngleSteps or AngleList, optional
        The views' angles, where the file carries none.
    detector_pitch_mm, row_pitch_mm : float, optional
        Known distances between cells and between rows; a file with other values is refused.
    rows_missing : bool
        Whether views may lack rows at the top or the bottom: NaN in every cell, of counts also zero. They become NaN.
    max_bytes : int
        Largest size of one array, as float32 or as stored, whichever is more.
    free_bytes : int, optional
        The machine's free memory: what has to be read as a whole and does not fit is refused before it is read.

    Raises
    ------
    UnreadableScan
        When the file cannot be read, is not a scan, or contradicts what was given beside it.
    """
    recognised = _recognise(path)
    # Twice: for a moment an array is there as stored and as float32, and there are flat and dark fields.
    piece = max_bytes if free_bytes is None else min(max_bytes, int(MEMORY_SHARE * free_bytes) // 2)
    with ExitStack() as files:
        with library_errors_translated(recognised.name):
            contents = recognised.read(path, dataset, Bounds(max_bytes, piece), files)
            _check_piece(contents.projections, piece)
        projections = _translated(contents.projections, recognised.name)
        dimensions = len(projections.shape)
        angles, remarks = _agree_on_angles(contents, angles_deg, projections.shape[0])
        if counts and contents.darks is None:
            remarks = (*remarks, "There are no dark fields: the detector's offset was taken as zero.")
        yield CanonicalScan(
            projections=projections,
            angles_rad=np.deg2rad(angles),
            counts=counts,
            flats=None if contents.flats is None else as_fields(contents.flats, dimensions),
            darks=None if contents.darks is None else as_fields(contents.darks, dimensions),
            detector_pitch_mm=_agree_on_pitch("detector_pitch_mm", contents.detector_pitch_mm, detector_pitch_mm),
            row_pitch_mm=_agree_on_pitch("row_pitch_mm", contents.row_pitch_mm, row_pitch_mm),
            format=contents.format,
            remarks=(*contents.remarks, *remarks),
            rows_missing=rows_missing,
            unused=contents.unused,
        )


def _check_piece(projections: Projections, most_bytes: int) -> None:
    """Refuse what the file stores in pieces that cannot be in memory twice, as stored and as float32."""
    views, rows = (min(n, most) for n, most in zip(projections.together, projections.shape, strict=False))
    needed = 4 * views * rows * projections.shape[-1]
    if needed > most_bytes:
        raise UnreadableScan(
            "too-large",
            f"the file stores its projections in pieces of {needed} bytes, where pieces of {most_bytes} fit into the "
            "free memory; store them in smaller chunks",
        )


def _translated(projections: Projections, what: str) -> Projections:
    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        with library_errors_translated(what):
            return projections.read(views, rows)

    return replace(projections, read=read)


def _recognise(path: Path) -> _Format:
    with path.open("rb") as stream:
        head = stream.read(HDF5_OFFSETS[-1] + len(HDF5_SIGNATURE))
    if not head:
        raise UnreadableScan("empty-file", "the file is empty; upload it again")
    if any(head[offset:].startswith(HDF5_SIGNATURE) for offset in HDF5_OFFSETS):
        return _HDF5
    if head[124:128] in MAT_VERSIONS:
        return _MAT
    for first_bytes, known in _BY_FIRST_BYTES:
        if head.startswith(first_bytes):
            return known
    raise UnreadableScan(
        "unknown-format",
        "the file is none of HDF5 (NXtomo, Data Exchange), TIFF, ZIP of TIFFs, NPY, NPZ or MAT; "
        "export it as one of them",
    )


def _agree_on_angles(
    contents: FileContents, given: AnglesGiven | None, views: int
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    if given is None:
        if contents.angles_deg is None:
            reason = contents.angles_unusable or "the file carries no angles"
            raise UnreadableScan(
                "angles-missing",
                f"{reason}; give them as START:STEP in degrees, as in 0.5:1, or one for each view "
                "(angles_deg, on the command line --angles-deg or --angles-file)",
            )
        return contents.angles_deg, ()
    angles = given.expand(views)
    if contents.angles_deg is not None:
        _check_same_angles(contents.angles_deg, angles)
        return contents.angles_deg, ()
    if contents.angles_unusable is not None:
        return angles, (f"The angles given were used: {contents.angles_unusable}.",)
    return angles, ()


def _check_same_angles(in_file: NDArray[np.float64], given: NDArray[np.float64]) -> None:
    if in_file.shape != given.shape:
        raise UnreadableScan(
            "angles-mismatch", f"the file carries {in_file.size} angles for {given.size} views; each view needs its own"
        )
    # A file may keep its angles in single precision, which is coarser than the tolerance near 360 degrees.
    different = ~(np.abs(in_file - given) <= ANGLE_TOLERANCE_DEG + SINGLE_PRECISION * np.abs(given))
    if different.any():
        view = int(np.argmax(different))
        raise UnreadableScan(
            "contradiction",
            f"the file says that view {view} is at {in_file[view]:.9g} degrees and the angles given say "
            f"{given[view]:.9g}; leave the angles out or correct them",
        )


def _agree_on_pitch(name: str, in_file: float | None, given: float | None) -> float | None:
    if in_file is None or given is None:
        return in_file if given is None else given
    if abs(in_file - given) > PITCH_TOLERANCE * abs(given):
        raise UnreadableScan(
            "contradiction",
            f"the file says that {name} is {in_file:.9g} and {given:.9g} was given; correct one of them",
        )
    return in_file
