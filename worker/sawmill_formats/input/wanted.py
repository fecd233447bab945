"""Which array of a file is read."""

from dataclasses import dataclass
from enum import StrEnum


class FieldKind(StrEnum):
    """What counts are compared with: air, and the detector without a beam."""

    FLATS = "flats"
    DARKS = "darks"


@dataclass(frozen=True)
class Wanted:
    """What a reader looks for.

    Attributes
    ----------
    dataset : str or None
        Its path or name, where the file holds several arrays; None for the only one that can be meant.
    fields : FieldKind or None
        Fields that have a file of their own; None for the projections of a scan, with all that stands beside them.
    deviations : bool
        Whether the projections' standard deviations may stand beside them.
    transpose : bool
        Whether the file has the axes in reverse order; readers give them as they are stored.
    """

    dataset: str | None = None
    fields: FieldKind | None = None
    deviations: bool = False
    transpose: bool = False

    @property
    def least_images(self) -> int:
        """The fewest that can be meant."""
        return 1 if self.fields else 3
