"""The sha256 of large files, noted next to them: a download begins with it, and need not read the file twice.

`.<name>.sha256` contains the digest with the size and the modification time that the file had. While these are the
same, the file is not read; a file with other values is not the one that was noted.
"""

import hashlib
import os
import re
import threading
from pathlib import Path
from typing import NamedTuple

from sawmill_platform.errors import StorageUnavailable, disk_outage_reported
from sawmill_platform.files.file_store import note_of
from sawmill_platform.files.whole_files import renamed

# Smaller files are read within some 30 ms.
NOTED_FROM_BYTES = 8 * 1024**2

_NOTE = re.compile(rb"([0-9a-f]{64}) ([0-9]+ [0-9]+)")


def note_digests(folder: Path) -> None:
    """Note the digests of a result's large files.

    Raises
    ------
    StorageFull
        The disk is full.
    """
    for path in list(folder.iterdir()):
        status = path.stat()
        if path.is_file() and status.st_size >= NOTED_FROM_BYTES:
            with disk_outage_reported("a result"):
                note_digest(path, status, compute_digest(path, status))


class Note(NamedTuple):
    """The digest of a file, with the size and the time by which an unchanged file is recognised."""

    digest: bytes
    stamp: str

    def is_of(self, status: os.stat_result) -> bool:
        """Return whether the digest of a file with this status is known."""
        return self.stamp == _stamp(status)


def read_note(path: Path) -> Note | None:
    """Return the note on a file; None if there is no note, or the note is damaged."""
    try:
        found = _NOTE.fullmatch(note_of(path).read_bytes())
    except FileNotFoundError:
        return None
    return found and Note(bytes.fromhex(found[1].decode()), found[2].decode())


def note_digest(path: Path, status: os.stat_result, digest: bytes) -> None:
    """Write a digest next to its file; a note is complete or missing."""
    note = note_of(path)
    new = note.with_name(f"{note.name}.{os.getpid()}-{threading.get_ident()}")
    with renamed(new, note):
        new.write_text(f"{digest.hex()} {_stamp(status)}")


def compute_digest(path: Path, status: os.stat_result) -> bytes:
    """Compute the digest of a file in its state when `status` was taken; the call takes as long as reading the file.

    Raises
    ------
    FileNotFoundError
        The file is gone.
    StorageUnavailable
        The file has been replaced by now.
    """
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").digest()
        read = os.fstat(file.fileno())
    if _stamp(read) != _stamp(status):
        raise StorageUnavailable(f"{path.name} was replaced while it was read: ask for it again")
    return digest


def _stamp(status: os.stat_result) -> str:
    return f"{status.st_size} {status.st_mtime_ns}"
