"""Selection of the array that is read from a file."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class FieldKind(StrEnum):
    """Kinds of fields that counts are compared with: air, and the detector without a beam."""

    FLATS = "flats"
    DARKS = "darks"


@dataclass(frozen=True)
class Wanted:
    """Arrays of a file that a reader reads.

    Attributes
    ----------
    dataset : str or None
        Path or name, where the file holds several arrays; None for the only candidate.
    fields : FieldKind or None
        Fields in a file of their own; None for the projections of a scan, with all related arrays.
    deviations : bool
        Whether the file may hold the projections' standard deviations.
    transpose : bool
        Whether the file has the axes in reverse order; readers give them as they are stored.
    apart : frozenset of Path
        Files of a folder that are read apart, as fields.
    """

    dataset: str | None = None
    fields: FieldKind | None = None
    deviations: bool = False
    transpose: bool = False
    apart: frozenset[Path] = frozenset()

    @property
    def least_images(self) -> int:
        """Fewest images that can be meant."""
        return 1 if self.fields else 3
