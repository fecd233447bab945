"""Reading of HDF5 files in a separate process, before this process opens the files.

On some damaged files the HDF5 library crashes, or loops with Python's lock held: no exception and no signal handler
ends that. The other process (`hdf5_walk`) meets the same fault, and can be killed.
"""

import signal
import subprocess
from functools import lru_cache
from pathlib import Path

from sawmill_formats.errors import UnreadableScan
from sawmill_platform.attempts.failures import crashed_reader, endless_reader
from sawmill_platform.attempts.importing import PROGRAM
from sawmill_platform.contracts.kind_declarations import reading_limit_s
from sawmill_platform.files.verified_results import FileIdentity, identity_of

WALK = (*PROGRAM, "sawmill_formats.hdf5_walk")


def read_apart(
    *paths: Path | None, follow_links: bool = False, limit_s: float | None = None, walk: tuple[str, ...] = WALK
) -> None:
    """Read the structure of each HDF5 file in a separate process; a file that does not change is read once.

    Parameters
    ----------
    paths
        Files of any format and folders, of which HDF5 files are read; null: none.
    follow_links
        Whether the files may lead into other files.
    limit_s
        Seconds that reading may take; null: by the file's size.
    walk
        Command of the other process, without the path.

    Raises
    ------
    UnreadableScan
        `broken-file`: the reader crashed, or did not end.
    """
    import h5py  # noqa: PLC0415 - a worker at rest does not hold h5py

    for path in paths:
        if path is not None and h5py.is_hdf5(path):
            command = (*walk, str(path.absolute()), *(["follow-links"] if follow_links else []))
            _read_apart(command, identity_of(path.stat()), limit_s or reading_limit_s(path.stat().st_size))


@lru_cache(maxsize=1024)
def _read_apart(command: tuple[str, ...], _: FileIdentity, limit_s: float) -> None:
    silent = subprocess.DEVNULL
    try:
        done = subprocess.run(command, stdin=silent, stdout=silent, timeout=limit_s, check=False)  # noqa: S603 - ours
    except subprocess.TimeoutExpired:
        raise UnreadableScan("broken-file", endless_reader("file", limit_s)) from None
    if done.returncode < 0:
        raise UnreadableScan("broken-file", crashed_reader("file", signal.Signals(-done.returncode)))
    done.check_returncode()
