"""Which scan is meant, before anything is read: light, since the command line imports it at its start."""

from dataclasses import dataclass
from pathlib import Path

from sawmill_contracts.preparing import PrepareOptions
from sawmill_contracts.scans import UnregisteredScanOptions
from sawmill_formats.input.angles import AnglesGiven


@dataclass(frozen=True)
class ScanSource:
    """A scan's file, how it is read, and which of its views and rows are used."""

    path: Path
    options: UnregisteredScanOptions
    angles: AnglesGiven | None = None
    views: int | None = None
    rows: str | None = None

    @property
    def prepare(self) -> PrepareOptions:
        """What is done to the data on reading."""
        return PrepareOptions(**{name: getattr(self.options, name) for name in PrepareOptions.model_fields})
