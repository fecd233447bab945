"""Reading of an HDF5 file in a process of its own, before this process opens the file.

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
from sawmill_platform.contracts.kinds import reading_limit_s
from sawmill_platform.files.verified_results import FileIdentity, identity_of

WALK = (*PROGRAM, "sawmill_formats.hdf5_walk")


def read_apart(
    path: Path, *, follow_links: bool = False, limit_s: float | None = None, walk: tuple[str, ...] = WALK
) -> None:
    """Read the structure of an HDF5 file in a process of its own; a file that does not change is read once.

    Parameters
    ----------
    follow_links
        Whether the file may lead into other files.
    limit_s
        Seconds that reading may take; null: by the file's size.
    walk
        Command of the other process, without the path.

    Raises
    ------
    UnreadableScan
        `broken-file`: the reader crashed, or did not end.
    FileNotFoundError
        There is no file.
    """
    _read_apart(path.absolute(), identity_of(path.stat()), follow_links, limit_s, walk)


@lru_cache(maxsize=1024)
def _read_apart(
    path: Path,
    identity: FileIdentity,
    follow_links: bool,  # noqa: FBT001 - a key of the cache
    limit_s: float | None,
    walk: tuple[str, ...],
) -> None:
    limit_s = limit_s or reading_limit_s(identity[2])
    command = [*walk, str(path), *(["follow-links"] if follow_links else [])]
    try:
        done = subprocess.run(  # noqa: S603 - our own command
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        raise UnreadableScan("broken-file", endless_reader("file", limit_s)) from None
    if done.returncode < 0:
        raise UnreadableScan("broken-file", crashed_reader("file", signal.Signals(-done.returncode)))
    done.check_returncode()
