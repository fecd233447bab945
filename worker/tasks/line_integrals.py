"""A scan as read, in line integrals."""

import numpy as np
from numpy.typing import NDArray

from worker.formats.canonical import CanonicalScan
from worker.tomography.preprocess import line_integrals

Stack = NDArray[np.float32]


def as_line_integrals(read: CanonicalScan) -> tuple[Stack, Stack | None, tuple[str, ...]]:
    """The stack (views, rows, detector), the air level (rows, detector) of counts, and what was done."""
    if not read.counts or read.flats is None:
        return read.projections, None, read.remarks
    made = line_integrals(read.projections, read.flats, read.darks)
    return made.stack, made.air_level, (*read.remarks, *made.remarks)
