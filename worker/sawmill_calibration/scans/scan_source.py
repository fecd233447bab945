"""Specification of a scan before it is read; a small module, because the command line imports it at its start."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from sawmill_contracts.scans import UnregisteredScanOptions
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.angles import AnglesGiven


@dataclass(frozen=True)
class ScanSource:
    """A scan's file, the options of reading, and the selection of views and rows."""

    path: Path
    options: UnregisteredScanOptions
    angles: AnglesGiven | None = None
    views: int | None = None
    rows: str | None = None


@contextmanager
def links_offered(*, followed: bool) -> Iterator[None]:
    """Name the flag that follows links where a file is refused for its links; a refused upload does not name it."""
    try:
        yield
    except UnreadableScan as error:
        if error.code != "external-storage" or followed:
            raise
        raise UnreadableScan(error.code, f"{error}, or read the other files too by --follow-links") from error
