"""Reserve file next to SQLite's file, given up piece by piece for rows that must be written on a full disk.

Only cancellations use the reserve: without it, the job that fills the disk could not be stopped.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path

# A cancellation changes some thirty pages of 4 KiB, which the write-ahead log takes.
PIECE_BYTES = 256 * 2**10
SPARE_BYTES = 16 * PIECE_BYTES


class SpareRoom:
    """A file without content that uses disk space; processes share it."""

    def __init__(self, database: Path | None) -> None:
        self._path = None if database is None else Path(f"{database}.spare")

    def fill(self, reserve_bytes: int) -> None:
        """Restore the file if the disk then still has this number of bytes free; raise `OSError`."""
        path = self._path
        if path is None or (path.exists() and path.stat().st_size == SPARE_BYTES):
            return
        if shutil.disk_usage(path.parent).free >= reserve_bytes + SPARE_BYTES:
            with path.open("ab") as file:
                os.posix_fallocate(file.fileno(), 0, SPARE_BYTES)

    def give_up_piece(self) -> None:
        """Release a piece for the current transaction; if that fails, the transaction reports the full disk."""
        if self._path is not None:
            with suppress(OSError):
                os.truncate(self._path, max(self._path.stat().st_size - PIECE_BYTES, 0))
