"""Contents of one file, before they are compared with the client's parameters, and what of a file is read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan, quoted
from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason

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


ReadBlock = Callable[[slice, slice], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Projections:
    """The projections of an open file, read block by block."""

    shape: tuple[int, ...]  # (views, rows, detector) or (views, detector): shape as stored
    # Reads a slice of views and one of rows (the one row of a sinogram), each with start and stop inside the shape:
    # (views, rows, detector) float32, contiguous and the caller's own
    read: ReadBlock
    # (views, rows): size of what the file stores in one piece: blocks of whole pieces read each once
    together: tuple[int, int]


def held(array: NDArray[np.float32]) -> Projections:
    """Return projections (views, rows, detector) or (views, detector) that are in memory as a whole."""
    stack = array[:, np.newaxis, :] if array.ndim == 2 else array
    return Projections(array.shape, lambda views, rows: stack[views, rows].copy(), (1, 1))


def in_order(stored: Projections, order: tuple[int, ...]) -> Projections:
    """Return projections of a file whose axes have another order; `order` has the file's axes in ours."""
    shape = tuple(stored.shape[axis] for axis in order)
    # A sinogram is read as a stack of one row, whose axis is the middle one.
    axes = order if len(order) == 3 else (2 * order[0], 1, 2 * order[1])
    together = (*stored.together, stored.shape[-1])

    def read(views: slice, rows: slice) -> NDArray[np.float32]:
        parts = dict(zip(axes, (views, rows, slice(0, shape[-1])), strict=True))
        return np.ascontiguousarray(stored.read(parts[0], parts[1])[..., parts[2]].transpose(axes))

    return Projections(shape, read, (together[axes[0]], together[axes[1]]))


def named_axes(order: tuple[int, ...]) -> str:
    """Name the axes of a file in its own order."""
    names = AXES if len(order) == 3 else AXES[::2]
    return ",".join(names[order.index(axis)] for axis in range(len(order)))


def axes_of_fields(dimensions: int, order: tuple[int, ...]) -> tuple[int, ...]:
    """Return the axes of fields in our order: as many as the projections have, or without the views' for one field."""
    if dimensions == len(order):
        return order
    others = order[1:]
    return tuple(sorted(others).index(axis) for axis in others) if dimensions == len(others) else ()


def fields_in_order(
    fields: NDArray[np.float32] | None, order: tuple[int, ...], shape: tuple[int, ...]
) -> NDArray[np.float32] | None:
    """Return fields of a file with the axes of projections of this shape; fields that fit as they are stay so."""
    if fields is None or not (axes := axes_of_fields(fields.ndim, order)):
        return fields
    ordered = np.ascontiguousarray(fields.transpose(axes))
    return fields if (fields.shape[1 - len(shape) :] == shape[1:] != ordered.shape[1 - len(shape) :]) else ordered


@dataclass(frozen=True, eq=False)
class FileAngles:
    """The angles (n,) float64 that a file carries, in degrees, their unit in the file, and why they cannot be used."""

    deg: NDArray[np.float64] | None = None
    unit: str | None = None
    unusable: Reason | None = None


@dataclass(frozen=True)
class FilePitch:
    """The distance between cells or rows that a file carries, in mm, and the binning in it; remarks on both."""

    mm: float | None = None
    binning: int = 1
    remarks: tuple[Reason, ...] = ()


@dataclass(frozen=True, eq=False)
class FileContents:
    """The reading of one file."""

    format: str  # format of the file
    projections: Projections  # as stored: counts or line integrals, which no file states reliably
    flats: NDArray[np.float32] | None = None
    darks: NDArray[np.float32] | None = None
    deviations: NDArray[np.float32] | None = None  # their standard deviations
    angles: FileAngles = FileAngles()  # the views' angles
    # (int, str) or None: another axis than the views', with the arrays that could be angles by their names and have its
    # length
    angles_of_axis: tuple[int, str] | None = None
    order: tuple[int, ...] | None = None  # the file's axes in our order, where the file states it or it was given
    # Arrays that could be fields by their names, where it is not clear which
    possible_fields: Mapping[FieldKind, str] = field(default_factory=dict)
    pitch: FilePitch = FilePitch()  # distance between cells and between rows
    row_pitch: FilePitch = FilePitch()
    detector_modules: tuple[DetectorModule, ...] = ()  # modules of the detector after the first
    # Values that could serve as pitch or distance, where the file does not state what they are
    unused: str | None = None
    remarks: tuple[Reason, ...] = ()  # changes that were made to the data, and what the file lacks
    others: tuple[Path, ...] = ()  # further files that were read: of the fields, in a folder, behind links
