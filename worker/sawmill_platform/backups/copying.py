"""Copies of files into a backup and out of a backup, with their sums."""

import hashlib
import os
import shutil
from pathlib import Path
from typing import BinaryIO

from sawmill_platform.backups.manifest import Counted, Summed, blocks_of
from sawmill_platform.errors import StorageFull


def copy(reading: BinaryIO, target: Path, counted: Counted, *, mtime_ns: int, most_bytes: int | None = None) -> Summed:
    """Copy an open file to a new file.

    Raises
    ------
    Damaged
        The open file cannot be read.
    """
    computed, size_bytes = hashlib.sha256(), 0
    with target.open("xb") as writing:
        for block in blocks_of(reading, most_bytes):
            writing.write(block)
            computed.update(block)
            size_bytes += len(block)
            counted(len(block))
        writing.flush()
        os.utime(writing.fileno(), ns=(mtime_ns, mtime_ns))
    return Summed(size_bytes=size_bytes, sha256=computed.hexdigest())


def check_room_for(folder: Path, needed_bytes: int, what: str, *, reserve_bytes: int = 0) -> None:
    """Check that a disk has room.

    Raises
    ------
    StorageFull
        The disk has less room.
    """
    free_bytes = shutil.disk_usage(folder).free - reserve_bytes
    if needed_bytes > free_bytes:
        msg = f"{what} needs {needed_bytes / 1e9:.2f} GB, and {max(free_bytes, 0) / 1e9:.2f} GB are free for it "
        raise StorageFull(msg + f"where {str(folder)!r} is")


def has_links(folder: Path) -> bool:
    """Return whether files in a folder can have second names (hard links)."""
    first, second = folder / ".first", folder / ".second"
    first.touch()
    try:
        second.hardlink_to(first)
    except OSError:
        return False
    finally:
        second.unlink(missing_ok=True)
        first.unlink()
    return True
