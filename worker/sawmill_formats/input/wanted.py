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
    """Arrays of a file that a reader reads."""

    dataset: str | None = None  # path or name, where the file holds several arrays; None for the only candidate
    fields: FieldKind | None = None  # fields in a file of their own
    deviations: bool = False  # whether the file may hold the projections' standard deviations
    transpose: bool = False  # whether the file has the axes in reverse order; readers give them as they are stored
    apart: frozenset[Path] = frozenset()  # files of a folder that are read apart, as fields
    axes: str | None = None  # names of the file's axes in their order, as an alternative to `transpose`
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
