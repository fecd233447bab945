"""Selection of the array that is read from a file."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from sawmill_formats.errors import UnreadableScan, quoted

AXES = ("views", "rows", "cells")


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
    axes : str or None
        Names of the file's axes in their order, as an alternative to `transpose`.
    similar : frozenset of FieldKind
        Kinds of fields that may be recognised by similar names, because they are needed and given nowhere else.
    """

    dataset: str | None = None
    fields: FieldKind | None = None
    deviations: bool = False
    transpose: bool = False
    apart: frozenset[Path] = frozenset()
    axes: str | None = None
    similar: frozenset[FieldKind] = frozenset()

    @property
    def least_images(self) -> int:
        """Fewest images that can be meant."""
        return 1 if self.fields else 3

    def order(self, dimensions: int) -> tuple[int, ...] | None:
        """Return the file's axes in our order, or None where no order is given: `contradiction` for other axes."""
        if self.axes is None:
            return tuple(reversed(range(dimensions))) if self.transpose else None
        ours, names = AXES if dimensions == 3 else AXES[::2], self.axes.split(",")
        if self.transpose or sorted(names) != sorted(ours):
            raise UnreadableScan(
                "contradiction",
                f"axes is {quoted(self.axes)!r}; it must name {', '.join(ours)}, one for each axis of the projections, "
                "in the order of the file, and goes without transpose",
            )
        return tuple(names.index(name) for name in ours)
