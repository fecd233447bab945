"""Specification of a scan before it is read; a small module, because the command line imports it at its start."""

from dataclasses import dataclass
from pathlib import Path

from sawmill_contracts.preparing import PrepareOptions
from sawmill_contracts.scans import UnregisteredScanOptions
from sawmill_formats.input.angles import AnglesGiven


@dataclass(frozen=True)
class ScanSource:
    """A scan's file, the options of reading, and the selection of views and rows."""

    path: Path
    options: UnregisteredScanOptions
    angles: AnglesGiven | None = None
    views: int | None = None
    rows: str | None = None

    @property
    def prepare(self) -> PrepareOptions:
        """Preparation of the data on reading."""
        return PrepareOptions(**{name: getattr(self.options, name) for name in PrepareOptions.model_fields})
