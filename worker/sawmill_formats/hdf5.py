"""Opening of our HDF5 files: for writing, whole or not at all; for reading, on shared folders too."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import h5py

from sawmill_platform.files.whole_files import flush_names, flushed, renamed

if TYPE_CHECKING:
    from typing_extensions import Buffer


def open_hdf5(path: Path) -> h5py.File:
    """Open for reading; locks are no obstacle on a shared folder."""
    return h5py.File(path, "r", locking="best-effort")


@contextmanager
def whole_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield a new HDF5 file next to the target; flush and rename it when the block ends without an error."""
    temporary = path.with_name(f".{path.name}.{uuid4().hex}.part")
    with renamed(temporary, path), flushed(_DeafFile(temporary, "x+")) as disk:
        try:
            with h5py.File(disk, "w") as file:
                yield file
        except Exception:
            # Data read back after a failed write are wrong: the failed write is the error to report.
            disk.complain(path.name)
            raise
        disk.complain(path.name)
    flush_names(path.parent)


class _DeafFile(io.FileIO):
    """A file that stores its first failure and from then on only pretends to write.

    The HDF5 library ends the process when a write fails under it (measured with HDF5 2.0, natively and through Python
    file objects), so the failure is kept from it until it has closed the file.
    """

    failure: OSError | None = None

    def write(self, data: "Buffer", /) -> int:
        rest = memoryview(data).cast("B")
        length = len(rest)
        try:
            while self.failure is None and len(rest):
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.failure = error
        return length

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return self.tell() if size is None else size

    def complain(self, name: str) -> None:
        """Raise the failure, if there was one."""
        if self.failure is not None:
            raise OSError(self.failure.errno, f"{name} could not be written: {self.failure.strerror}")
