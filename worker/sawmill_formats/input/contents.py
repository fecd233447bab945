"""Contents of one file, before they are compared with the client's parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason

ReadBlock = Callable[[slice, slice], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Projections:
    """The projections of an open file, read block by block.

    Attributes
    ----------
    shape : (views, rows, detector) or (views, detector)
        Shape as stored.
    read : callable
        Reads a slice of views and one of rows (the one row of a sinogram), each with start and stop inside the shape:
        (views, rows, detector) float32, contiguous and the caller's own.
    together : (views, rows)
        Size of what the file stores in one piece: blocks of whole pieces read each once.
    """

    shape: tuple[int, ...]
    read: ReadBlock
    together: tuple[int, int]


def held(array: NDArray[np.float32]) -> Projections:
    """Return projections (views, rows, detector) or (views, detector) that are in memory as a whole."""
    stack = array[:, np.newaxis, :] if array.ndim == 2 else array
    return Projections(array.shape, lambda views, rows: stack[views, rows].copy(), (1, 1))


def reversed_axes(stored: Projections) -> Projections:
    """Return projections of a file that has the axes in reverse order, the detector's first and the views' last."""
    cells, *rows, views = stored.shape
    if not rows:  # the one row is read as a whole
        whole = slice(0, cells), slice(0, 1)
        return Projections(
            (views, cells),
            lambda part, _: np.ascontiguousarray(stored.read(*whole)[:, 0, part].T[:, np.newaxis]),
            (views, 1),
        )
    return Projections(
        (views, *rows, cells),
        lambda part, of_rows: np.ascontiguousarray(stored.read(slice(0, cells), of_rows)[:, :, part].T),
        (views, stored.together[1]),
    )


@dataclass(frozen=True, eq=False)
class FileAngles:
    """The angles that a file carries.

    Attributes
    ----------
    deg : (n,) float64, degrees, or None
        None where there are none, or they cannot be used.
    unit : str or None
        Unit in the file.
    unusable : Reason or None
        Why they cannot be used, where there are some.
    """

    deg: NDArray[np.float64] | None = None
    unit: str | None = None
    unusable: Reason | None = None


@dataclass(frozen=True, eq=False)
class FileContents:
    """The reading of one file.

    Attributes
    ----------
    format : str
        Format of the file.
    projections : Projections
        As stored: counts or line integrals, which no file states reliably.
    flats, darks : like the projections, or with one dimension less where there is a single one, float32
    deviations : like the projections, float32
        Their standard deviations.
    angles_deg : (views,) float64, degrees
    angles_unit : str or None
        Unit of the angles in the file.
    angles_unusable : Reason or None
        Reason why the angles in the file cannot be used, where it has some.
    angles_of_last_axis : str or None
        Array that could be angles by its name and has the length of the last axis, not of the first.
    transposed : bool
        Whether the file has the axes in the reverse of this order.
    detector_pitch_mm, row_pitch_mm : float or None
        Distance between cells and between rows.
    detector_modules : tuple of DetectorModule
        Modules of the detector after the first.
    unused : str or None
        Values that could serve as pitch or distance, where the file does not state what they are.
    remarks : tuple of Reason
        Changes that were made to the data, and what the file lacks.
    others : tuple of Path
        Further files that were read: of the fields, in a folder, behind links.
    """

    format: str
    projections: Projections
    flats: NDArray[np.float32] | None = None
    darks: NDArray[np.float32] | None = None
    deviations: NDArray[np.float32] | None = None
    angles_deg: NDArray[np.float64] | None = None
    angles_unit: str | None = None
    angles_unusable: Reason | None = None
    angles_of_last_axis: str | None = None
    transposed: bool = False
    detector_pitch_mm: float | None = None
    row_pitch_mm: float | None = None
    detector_modules: tuple[DetectorModule, ...] = ()
    unused: str | None = None
    remarks: tuple[Reason, ...] = ()
    others: tuple[Path, ...] = ()
